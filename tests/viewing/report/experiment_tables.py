"""Writes the tables of an experiment, for tests of its report."""


def write_curves(folder, columns, rows):
    """Write `curves.csv` into `folder`."""
    lines = [",".join(columns), *(",".join(map(str, row)) for row in rows)]
    (folder / "curves.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
