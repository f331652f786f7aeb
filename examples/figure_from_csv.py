"""Draw a figure from the tables of a run: `python examples/figure_from_csv.py PICTURE --run RUN_FOLDER`."""

import argparse
import csv
from pathlib import Path

import matplotlib.pyplot as plt

SHIPPED_RUN = Path(__file__).parents[1] / "results" / "ant-gather-laptop"
PANELS = (
    ("progress.csv", "primitive_return_mean", "primitive return (training)"),
    ("evaluation.csv", "score_mean", "score (evaluation)"),
)


def read(path: Path) -> dict[str, list[float]]:
    """Return the columns of a table by name."""
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return {name: [float(value) for value in column] for name, *column in zip(header, *rows, strict=True)}


def main(run: Path, picture: Path) -> None:
    """Draw one column of each table against the environment steps of the run."""
    figure, axes = plt.subplots(1, len(PANELS), figsize=(9, 3.5), layout="constrained")
    for axis, (table, column, title) in zip(axes, PANELS, strict=True):
        columns = read(run / table)
        axis.plot([steps / 1e6 for steps in columns["env_steps"]], columns[column])
        axis.set(title=title, xlabel="million environment steps")
        axis.grid(alpha=0.3)
    figure.savefig(picture, dpi=150)
    print(f"{picture}: {int(columns['generation'][-1])} generations of {run.name}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("picture", nargs="?", type=Path, default=Path("figure.png"))
    parser.add_argument("--run", type=Path, default=SHIPPED_RUN, help="run folder (default: %(default)s)")
    arguments = parser.parse_args()
    main(arguments.run, arguments.picture)
