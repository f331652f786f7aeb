"""Stands in for huggingface_hub: the calls of `docs/how-to/share.md`. A repository is a folder below `hub`."""

import shutil
from pathlib import Path


class HfApi:
    def create_repo(self, repo_id, *, exist_ok=False):
        Path("hub", repo_id).mkdir(parents=True, exist_ok=exist_ok)

    def upload_folder(self, *, repo_id, folder_path):
        shutil.copytree(folder_path, Path("hub", repo_id), dirs_exist_ok=True)


def snapshot_download(repo_id, *, local_dir):
    (Path(local_dir) / ".cache").mkdir(parents=True)  # as the hub's own
    return str(shutil.copytree(Path("hub", repo_id), local_dir, dirs_exist_ok=True))
