"""The numbers of docs/paper.md are those of the tables that it links."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from shes.viewing.curves import confidence_interval
from tests.test_experiments_page import if_hiro_were_as_fast

ROOT = Path(__file__).parents[1]
PAGE = " ".join((ROOT / "docs" / "paper.md").read_text(encoding="utf-8").split())


def column(table, name, **where):
    """Return the numbers of a column of a table of results in its rows with these values, and the table's link."""
    path = Path("results") / f"{table}.csv"
    assert f"(../{path.as_posix()})" in PAGE
    with (ROOT / path).open(newline="", encoding="utf-8") as file:
        rows = [
            row for row in csv.DictReader(file) if all(re.fullmatch(value, row[key]) for key, value in where.items())
        ]
    assert rows, where
    return [float(row[name]) for row in rows]


def interval(values):
    low, high = confidence_interval(np.array(values)[:, None])
    return low[0], high[0]


def scores(values, sign="{:.2f}"):
    return ", ".join(sign.format(value) for value in values)


def listed(values, sign="{:g}"):
    texts = [sign.format(value) for value in values]
    return f"{', '.join(texts[:-1])} and {texts[-1]}"


def gather():
    """Return the ends of the lines of the gatherers."""
    ends = []
    for group in ("methods", "transfer"):
        values = column("paper/runs", "best_score", env="ant-gather", variant="pieces", group=group)
        low, high = interval(values)
        ends.append(f"| {scores(values)} | {np.mean(values):.2f}, {low:.2f} to {high:.2f} |")
    return ends


def to_targets():
    maze, push = (
        [
            100 * score
            for score in column("paper/runs", "best_score", env=f"ant-{task}", variant="pieces", group="methods")
        ]
        for task in ("maze", "push")
    )
    return (
        f"reach the target of Maze in {listed(maze, '{:.0f}')} % with seeds 1 to 5",
        f"that of Push in {listed(sorted(push), '{:.0f}')} % (sorted)",
    )


def pieces():
    def mean(variant):
        return f"{np.mean(column('learning/runs', 'last_return', group='pieces', variant=variant)):.0f}"

    return (
        f"has {mean('base')}. Without the egocentric view it has {mean('no-view')}, without the symmetry "
        f"{mean('no-symmetry')}, with a random output layer {mean('glorot-output')}, with whole episodes "
        f"{mean('episodes')}."
    )


def hiro():
    best = column("hiro/time_to_score", "best_score", method="hiro-ant-gather", score="1.0")
    minutes = np.divide(column("hiro/runs", "wall_time_s", group="hiro-ant-gather"), 60)
    of_maze = np.divide(column("hiro/runs", "wall_time_s", group="hiro-ant-maze"), 60)
    steps = column("hiro/runs", "env_steps", group="hiro-ant-gather")[0]
    (others,) = set(np.round(minutes[1:]))
    small = np.divide(column("paper/runs", "seconds", env="ant-.*", variant="hiro"), 60)
    return (
        f"has at most {best[0]:.2f} in {minutes[0]:.0f} minutes of one core, {steps / 1e3:.0f},000 of",
        f"{best[1]:.2f} and {best[2]:.2f} in {others:.0f} minutes",
        f"with the ant for {min(small):.0f} to {max(small):.0f} minutes there",
        f"its authors' settings for {min(of_maze):.0f} to {max(minutes):.0f} minutes",
    )


def seconds(method, score):
    found = column("hiro/time_to_score", "seconds", method=method, score=f"{score}.0")
    return f"{int(min(found) + 0.5)} to {int(max(found) + 0.5)}"


def ablation():
    def row(name, variant, env):
        return column("ablation/comparison", name, group="choices", variant=variant, env=env)[0]

    of_maze = {name: row("score_mean", name, "point-maze") for name in ("base", "mirrored-none", "reward-cosine")}
    p = {name: row("p_holm", name, "point-maze") for name in ("mirrored-none", "reward-cosine")}
    reached = f"({of_maze['base']:.2f} of the targets reached, {of_maze['mirrored-none']:.2f} without"
    return (
        f"{reached}, p = {p['mirrored-none']:.3f})",
        f"({of_maze['reward-cosine']:.2f} with the cosine, p = {p['reward-cosine']:.3f})",
    )


def walkers():
    best = column("learning/endings", "score_mean", env="ant-flagrun", agent=re.compile("runs/gather/walker/seed_."))
    upright = column("learning/endings", "upright_to_the_end", agent=re.compile("runs/gather/walker/seed_."))
    seconds = column("learning/endings", "wall_time_s", agent=re.compile("runs/gather/walker/seed_."))
    after = {
        generation: np.mean(column("learning/walkers", "return_mean", intervals="1", generation=generation))
        for generation in ("10", "30")
    }
    return (
        f"walks after 0.9 million steps, {min(seconds):.0f} to {max(seconds):.0f} seconds on two cores",
        f"of seeds 1 to 5 return {listed(best, '{:.0f}')}, and",
        f"upright to the end in {100 * min(upright):.0f} to {100 * max(upright):.0f} % of the episodes",
        f"average {after['10']:.0f} after 300,000 steps and {after['30']:.0f} after 900,000",
    )


def settings():
    def of_gather(variant, against, name="p_holm"):
        return column("ablation/comparison", name, env="point-gather", variant=variant, against=against)[0]

    frozen, scratch = of_gather("frozen", "scratch", "score_mean"), of_gather("scratch", "base", "score_mean")
    small, slow, long = (
        of_gather(name, "base") for name in ("sigma-x0.25", "learning-rate-x0.25", "controller-interval-x4")
    )
    return (
        f"({frozen:.2f}, from scratch {scratch:.2f}, p = {of_gather('frozen', 'scratch'):.3f})",
        f"a quarter of σ (p = {small:.3f}) or of the learning rate (p = {slow:.3f})",
        f"the goals' interval (p = {long:.3f})",
    )


def of_last(env, variant):
    values = column("paper/runs", "last_score", group="methods", env=env, variant=variant)
    return f"{np.mean(values):.2f}"


def p_of(value):
    return "<0.001" if value < 0.001 else f"{value:.{3 if value < 0.1 else 2}f}"


ENVS = [f"{body}-{task}" for body in ("point", "ant") for task in ("gather", "maze", "push")]


def line(env, *cells):
    return f"| {env.replace('-', ' ').title()} | {' | '.join(cells)} |"


def of_comparison(table, env, name, variant, against=""):
    place = {"group": "methods", "env": env, "variant": variant, "against": against}
    (value,) = column(f"paper/{table}", name, **place)
    return value


def score(table, env, *form):
    mean, error = (of_comparison(table, env, f"score_{name}", *form) for name in ("mean", "error"))
    return f"{mean:.2f} ± {error:.2f}"


def two_forms():
    lines = []
    for env in ENVS:
        both = "pieces", "published"
        scores = [
            text for form in (("published",), both) for text in (score("fig5", env, *form), of_last(env, form[0]))
        ]
        tests = [p_of(of_comparison("fig5", env, name, *both)) for name in ("p", "mann_whitney_p")]
        steps = of_comparison("fig5", env, "env_steps", "published") / 1e6
        seeds = of_comparison("fig5", env, "seeds", "published")
        effect = of_comparison("fig5", env, "superiority", *both)
        lines.append(line(env, f"{steps:.0f}", f"{seeds:.0f}", *scores, *tests, f"{effect:.2f}"))
    return lines


def against_hiro():
    both = "pieces", "hiro"
    lines = []
    for env in ENVS:

        def of(name, *form, env=env):
            return of_comparison("fig3", env, name, *form)

        def equal(budget, of=of):
            scores = f"{of(f'{budget}_score_against', *both):.2f} and {of(f'{budget}_score', *both):.2f}"
            p = p_of(of(f"{budget}_p_holm", *both))
            span = of(f"{budget}_span", *both)
            of_what = f"{60 * span:.1f} min" if budget == "hours" else f"{span / 1e6:.1f} M"
            return f"{scores} in {of_what}, p {p if p.startswith('<') else f'= {p}'}".replace("p <", "p < ")

        hiro, ours = (
            f"{score('fig3', env, name, against)}, {of_last(env, name)}"
            for name, against in (("hiro", "published"), both)
        )
        lines.append(line(env, hiro, ours, p_of(of("p_holm", *both)), equal("steps"), equal("hours")))
    gather, push = (if_hiro_were_as_fast(f"point-{task}")[1].removeprefix("p = ") for task in ("gather", "push"))
    minutes = [
        np.mean(column("paper/runs", "seconds", env="point-gather", variant=name, group="methods")) / 60
        for name in ("hiro", "pieces")
    ]
    assert round(minutes[0] / minutes[1]) == 6
    return [
        *lines,
        f"divided by 1.4 there, p over equal time is {gather} in Point Gather and {push} in Point Push.",
        "in {:.1f} minutes where SHES has {:.1f}.".format(*minutes),
    ]


def speed():
    def ratio(task, size):
        return column("speed", "value", measure=f"Ant {task}, {size}, 1 worker: ratio")[0]

    part = {name: column("policy_limit", "ratio", part=name)[0] for name in ("the rollout", READ)}
    return (
        f"runs at {ratio('Gather', '64 x 64'):.2f} (Gather) and {ratio('Flagrun', '64 x 64'):.2f} (Flagrun) of",
        f"with 3 × 256 networks at {ratio('Gather', '3 x 256'):.2f}",
        f"{part['the rollout']:.2f} on another machine, where {part[READ]:.3f} is the limit",
    )


READ = "forward pass: one read of the weights"
CLAIMS = {
    "walkers": walkers,
    "settings": settings,
    "two forms": two_forms,
    "against HIRO": against_hiro,
    "speed": speed,
    "gather": gather,
    "to targets": to_targets,
    "pieces": lambda: [pieces()],
    "hiro": hiro,
    "time to a score": lambda: [
        f"score of at least 1 comes after {seconds('coevolved', 1)} s, of 2 after {seconds('coevolved', 2)} s",
        f"and of 3 after {seconds('coevolved', 3)} s",
        f"needs {seconds('transfer', 1)}, {seconds('transfer', 2)} and {seconds('transfer', 3)} s",
    ],
    "ablation": ablation,
}


@pytest.mark.parametrize("claim", CLAIMS)
def test_the_page_says_what_its_tables_say(claim):
    for words in CLAIMS[claim]():
        assert words in PAGE


def test_every_linked_table_is_there():
    links = re.findall(r"\]\(\.\./([\w/.-]+\.(?:csv|json|png))\)", PAGE)
    assert len(links) > 20
    assert [link for link in links if not (ROOT / link).is_file()] == []
