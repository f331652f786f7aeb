"""The paper's experiments: Table I's settings, runs that are shared, workers, speed-ups, origin, tables and figures."""

import csv
import itertools
import json
import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from shes.algorithms.evolution.presets import SHES_PRESETS
from shes.cli import main
from shes.runs.tables import read_csv
from shes.studies import experiment as experiments
from shes.studies.comparison import compare
from shes.studies.figures import draw_figures
from shes.studies.named_studies import STUDIES
from shes.studies.paper_scales import SCALES
from shes.studies.provenance_columns import joined, provenance_columns
from shes.studies.running import check_study, run_cell, run_study
from shes.studies.study import ALONE, cell_config, cell_steps, planned_config
from shes.studies.study_tables import Cell, CellResults, write_tables
from shes.studies.summaries import read_summaries
from shes.studies.table1 import TABLE_1, settings_beside
from shes.training.make_config import make_config
from tests.e2e import runs

ROOT = Path(__file__).parents[2]
NAMES = ("table1", "fig3", "fig4", "fig5", "fig6")
TINY = {name: value for name, value in runs.TINY.items() if name not in ("preset", "seed", "backend")}
PART = {
    "machine": {"system": "Linux", "processor": "Zen", "cores": 24},
    "device": {"name": "cpu"},
    "versions": {"python": "3.12.1", "numpy": "2.4"},
    "git_commit": "12345678",
}


def rows(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# Table I.


@pytest.mark.parametrize("env", ["ant-gather", "ant-maze", "ant-push"])
def test_scale_paper_has_the_settings_of_table_one(env):
    found = settings_beside(env)
    assert len(found) == len(TABLE_1) == 11
    for row in found:
        assert row["shes_here"] == row["shes"], row
        # HIRO has no generations, and no number of CPU cores is a setting of its run.
        if row["parameter"] not in ("generations", "CPU cores"):
            assert row["hiro_here"] == row["hiro"], row


def test_the_runs_of_scale_paper_have_ten_seeds_ten_hours_and_three_numbers_of_workers():
    cells = STUDIES["table1"]("paper").cells
    assert {cell.seed for cell in cells} == set(range(1, 11))
    assert {cell.env for cell in cells} == {"ant-gather", "ant-maze", "ant-push"}
    assert {cell.settings["minutes"] for cell in cells} == {600.0}
    assert {cell.settings["num_workers"] for cell in STUDIES["fig4"]("paper").cells} == {48, 240, 600}


@pytest.mark.parametrize(("scale", "seeds"), [("paper", {"ant": 10}), ("laptop", {"point": 10, "ant": 5})])
@pytest.mark.parametrize("name", ["fig3", "fig4", "fig5"])
def test_every_variant_has_all_seeds_of_its_body_in_every_environment(name, scale, seeds):
    cells = STUDIES[name](scale).cells
    found = Counter((cell.group, cell.variant, cell.env) for cell in cells)
    assert found == {place: seeds[place[-1].partition("-")[0]] for place in found}
    assert {env for _, _, env in found} >= {f"{body}-{task}" for body in seeds for task in ("gather", "maze", "push")}


def test_the_learning_changes_of_scale_paper_are_those_of_the_preset_but_for_sizes_and_steps(tmp_path):
    others = {"primitive_hidden", "population_size", "generations", "horizon", "sigma"}
    for cell in (each for each in STUDIES["table1"]("paper", seeds=1).cells if each.variant == "pieces"):
        preset = SHES_PRESETS["laptop"].per_environment[cell.env].items()
        own = others if cell.env == "ant-gather" else {*others, "hidden"}  # an equivariant network counts by sector
        changes = {k: v for k, v in preset if k not in own and not k.startswith(("learning_rate", "schedule"))}
        values = cell_config(cell, tmp_path).values
        assert changes.items() <= values.items()
        assert 256 in (values["primitive_hidden"] or values["hidden"])


def test_the_walkers_of_scale_paper_with_the_learning_changes_are_trained_as_those_of_the_preset(tmp_path):
    walkers = {c.variant: c for c in STUDIES["fig5"]("paper", seeds=1).cells if c.env == "ant-flagrun"}
    ours, preset = (
        each.numbers() for each in (cell_config(walkers["pieces"], tmp_path), make_config("ant-flagrun", "laptop"))
    )
    for name in ("population_size", "sigma", "learning_rate", "intervals", "primitive_estimate", "fall_price"):
        assert ours[name] == preset[name], name
    generations = {cell_config(cell, tmp_path).run.generations for cell in walkers.values()}
    steps = [cell_steps(walkers[form], 0)[0] / 3000 for form in ("pieces", "published")]
    assert (generations, steps) == ({3000}, [30_000, 640_000])
    how_to = " ".join((ROOT / "docs" / "how-to" / "paper.md").read_text(encoding="utf-8").split())
    assert "has {:,.0f} environment steps, one of the walker as published {:,.0f}.".format(*steps) in how_to


@pytest.mark.parametrize("scale", SCALES)
def test_at_scale_laptop_every_method_trains_maze_on_its_own_target_and_none_is_shown_the_way(scale):
    cells = [each for each in STUDIES["fig5"](scale, 1).cells + STUDIES["fig3"](scale, 1).cells if "-maze" in each.env]
    assert {cell.variant for cell in cells} == {"published", "pieces", "hiro"}
    for cell in cells:
        values = planned_config(cell).values
        searches = (cell.variant, cell.body) == ("pieces", "ant")
        is_fixed = scale == "laptop" or searches
        assert (values["target"], values["waypoints"]) == ((0, 16) if is_fixed else None, None)
        if cell.group == "methods":
            assert values.get("explore", "none") == ("archive" if searches else "none")


@pytest.mark.parametrize("scale", SCALES)
def test_hiro_has_one_update_of_its_controller_for_ten_steps_as_published(scale, tmp_path):
    cells = [cell for cell in STUDIES["fig3"](scale, 1).cells if cell.variant == "hiro"]
    assert {cell_config(cell, tmp_path).values["controller_update_interval"] for cell in cells} == {10}


# The form as published, and the steps to the one with the learning changes.


@pytest.mark.parametrize(
    ("body", "tuned"), [("ant", set()), ("point", {"sigma", "learning_rate", "controller_interval"})]
)
def test_the_form_as_published_at_scale_laptop_is_preset_paper_but_for_its_size(body, tuned, tmp_path):
    sizes = {"hidden", "population_size", "episodes_per_policy", "statistics_fraction"}
    sizes |= {"noise_table_size", "generations", "env_steps"}
    # The task is that of every method: its first states, and its target.
    task = {"reset_noise", "horizon", "evaluation_horizon", "evaluation_episodes", "evaluation_interval"}
    task |= {"target", "primitive", "freeze_primitive"}
    cells = [
        cell
        for cell in STUDIES["fig5"]("laptop", 1).cells
        if (cell.env.partition("-")[0], cell.variant) == (body, "published")
    ]
    assert len(cells) == 7
    for cell in (replace(cell, primitive=None) for cell in cells):
        ours, paper = cell_config(cell, tmp_path).numbers(), make_config(cell.env, "paper").numbers()
        assert {name for name in ours if ours[name] != paper[name]} <= sizes | task | tuned
        changed = make_config(cell.env, "laptop").numbers()
        assert [ours[name] for name in ("reset_noise", "horizon")] == [changed["reset_noise"], 500]


def test_each_step_has_the_changes_of_those_before_it_and_the_last_differs_from_the_tuned_form(tmp_path):
    def values(body, variant):
        cells = STUDIES["fig3"]("laptop", 1).cells
        cell = next(each for each in cells if (each.env, each.variant) == (f"{body}-gather", variant))
        return cell_config(cell, tmp_path).values

    branches = {"primitive_estimate", "intervals", "primitive_population_size", "primitive_sigma"}
    branches |= {"primitive_learning_rate"}
    views = {"primitive_view", "goal_encoding"}
    wanted = {
        "point": {
            "views": views,
            "branches": branches - {"intervals"},
            "ties": {"output_weights", "weight_decay", "hold_tied"},
        },
        "ant": {
            "views": views,
            "symmetry": {"symmetry"},
            "branches": branches,
            "gait": {"clock_frequency", "fall_price", "output_weights", "weight_decay", "hold_tied"},
            "goals": {"controller_interval", "controller_output", "minimum_goal_distance"},
            "equivariant": {"controller_view", "controller_network", "hidden", "primitive_hidden"},
        },
    }
    for body, steps in wanted.items():
        before, last = values(body, "published"), values(body, "pieces")
        for step, names in steps.items():
            found = values(body, step)
            changed = {name for name in found if found[name] != before[name]} - {"evaluation_interval"}
            assert changed == names
            assert all(found[name] == last[name] for name in changed)
            before = found


@pytest.mark.parametrize("name", ["fig3", "fig4", "fig5"])
def test_the_ants_runs_are_evaluated_about_as_often_in_every_form(name, tmp_path):
    for cell in STUDIES[name]("laptop", 1).cells:
        if cell.env.startswith("ant") and cell.variant != "hiro":
            steps, _ = cell_steps(replace(cell, settings={**cell.settings, "env_steps": 1}), 1)  # of a generation
            evaluations = cell.settings["env_steps"] / steps / cell.settings["evaluation_interval"]
            # Figure 4 is so short that a generation is longer than a twentieth.
            assert (5 if name == "fig4" else 16) <= evaluations <= 23, cell.name


@pytest.mark.parametrize(("scale", "size"), [("paper", ""), ("laptop", ", small"), ("smoke", ", small")])
def test_a_form_that_is_smaller_than_in_table_1_is_called_small(scale, size):
    design = STUDIES["fig3"](scale, 1).design
    assert (design.label("published"), design.label("hiro")) == (f"as published{size}", f"HIRO{size}")


# Runs.


@pytest.mark.parametrize("scale", SCALES)
def test_table_1_and_figures_3_and_5_share_runs(scale):
    table, third, fifth = (
        {(cell.name, cell.digest) for cell in STUDIES[name](scale, seeds=1).cells}
        for name in ("table1", "fig3", "fig5")
    )
    assert table == third
    assert {name for name, _ in third - fifth} == {name for name, _ in third if "/hiro/" in name or "/steps/" in name}


@pytest.mark.parametrize("name", NAMES)
def test_scale_paper_has_settings_that_are_allowed(name, tmp_path):
    check_study(STUDIES[name]("paper", seeds=1), tmp_path)


def test_a_run_of_figure_4_has_its_own_number_of_workers(tmp_path):
    for cell in STUDIES["fig4"]("smoke").cells:
        config = cell_config(cell, tmp_path, {"backend": "processes", "num_workers": 7})
        assert f"{config.workers.num_workers}" == cell.variant.rpartition("-")[2]
        assert config.workers.backend == "processes"
    own = Cell(group="g", variant="v", env="point-gather", seed=5, preset="smoke", settings={**TINY, "num_workers": 2})
    summary = run_cell(own, tmp_path, 2, workers={**ALONE, "backend": "processes"})
    assert summary.row["workers"] == 2
    assert summary.row["seconds"] == read_csv(tmp_path / own.name / "progress.csv")["wall_time_s"][-1]


def test_the_time_of_a_run_in_one_process_is_that_of_the_processor(tmp_path):
    """With other work on the machine it would take longer, but no more of a core."""
    first = Cell(group="g", variant="p", env="point-flagrun", seed=5, preset="smoke", settings=TINY)
    second = Cell(group="g", variant="v", env="point-gather", seed=5, preset="smoke", settings=TINY, primitive=first)
    for cell in (first, second):
        summary = run_cell(cell, tmp_path, 2)
    progress, evaluation = (read_csv(tmp_path / second.name / f"{name}.csv") for name in ("progress", "evaluation"))
    assert summary.row["seconds"] == progress["process_time_s"][-1]
    assert [row["seconds"] for row in summary.curve] == evaluation["process_time_s"]
    before = read_csv(tmp_path / first.name / "progress.csv")["process_time_s"][-1]
    assert {row["primitive_seconds"] for row in summary.curve} == {before}


def test_every_run_has_the_steps_of_its_method_and_environment_at_scale_laptop():
    # million steps: figures 3 and 5 from scratch, on a transferred primitive, HIRO, figure 4 (with the whole machine)
    wanted = {"ant-gather": (6, 6, 0.3, 1.2), "ant-maze": (20, 2, 0.6, 0.8), "ant-push": (10, 2, 0.6, 0.8)}
    wanted |= {f"point-{task}": (3, 3, 0.3, 0.6) for task in ("gather", "maze", "push")}
    cells = [cell for name in ("fig3", "fig5", "fig4") for cell in STUDIES[name]("laptop", 1).cells]
    found = {
        (cell.env, "hiro" if cell.variant == "hiro" else cell.group, cell.settings["env_steps"] / 1e6)
        for cell in cells
        if not cell.env.endswith("flagrun") and cell.group != "steps"
    }
    groups = ("methods", "transfer", "hiro", "workers")
    assert found == {(env, *each) for env, all_n in wanted.items() for each in zip(groups, all_n, strict=True)}


@pytest.mark.parametrize("scale", ["laptop", "paper"])  # whose population the projection is of
def test_figure_6_measures_the_settings_of_table_1_and_flat_es(scale, tmp_path):
    study, runs_of = STUDIES["fig6"](scale, seeds=1), STUDIES["fig3"]("paper", seeds=1)
    trained = {cell.variant: cell_config(cell, tmp_path) for cell in runs_of.cells if cell.env == "ant-maze"}
    measured = {cell.variant: cell_config(cell, tmp_path) for cell in study.cells}
    assert list(measured) == ["published", "es", "pieces"]
    for form in ("published", "pieces"):
        ours, theirs = measured[form].numbers(), trained[form].numbers()
        assert {name for name in ours if ours[name] != theirs[name]} <= {"generations", "env_steps", "minutes"}
    assert (measured["published"].evolution.population_size, len(STUDIES["fig6"](scale).cells)) == (1000, 3)
    flat, published = measured["es"], measured["published"]
    assert flat.run.algorithm == "es"
    assert flat.networks.hidden == published.networks.hidden
    for name in ("population_size", "sigma", "learning_rate", "noise_table_size"):
        assert getattr(flat.evolution, name) == getattr(published.evolution, name)


# Speed-ups.


@pytest.fixture
def measured(monkeypatch):
    """Let a measurement be a table, and count the measurements."""
    calls = []

    def measure(config):
        calls.append((config.run.env, config.run.algorithm, config.workers.count))
        speedups = {("measured", 2): 1.9, ("projected", 48): 40.0, ("projected", 240): 150.0, ("projected", 600): 300.0}
        return [{"kind": k, "cores": n, "speedup": s, "start_s": math.nan} for (k, n), s in speedups.items()]

    monkeypatch.setattr("benchmarks.speedup.measure_speedup", measure)
    return calls


def test_a_measurement_is_a_summary_and_is_not_repeated(tmp_path, measured):
    study = STUDIES["fig6"]("smoke", seeds=2)
    assert next(run_study(study, tmp_path, num_workers=2, until=0)).summary is None  # the time is over
    assert measured == []
    outcomes = list(run_study(study, tmp_path, num_workers=2))
    assert [outcome.error for outcome in outcomes] == [""] * 6
    algorithms = [algorithm for _, algorithm, *_ in measured]
    assert sorted(algorithms) == ["es", "es", "shes", "shes", "shes", "shes"]
    assert {each[0::2] for each in measured} == {("point-maze", 2)}
    row = outcomes[0].summary.row
    assert (row["workers"], row["speedup_here"], row["speedup_600"]) == (2, 1.9, 300.0)
    assert outcomes[0].summary.curve[0]["start_s"] is None
    assert list(run_study(study, tmp_path, num_workers=2)) == []
    assert len(measured) == 6
    summaries = read_summaries(study, tmp_path)
    (tmp_path / "tables").mkdir()
    write_tables(study.ordered(), summaries, tmp_path / "tables")
    assert read_summaries(study, tmp_path / "tables") == summaries


# Origin.


def test_the_origin_of_a_run_names_hardware_versions_and_commit_of_each_part_once():
    other = {**PART, "git_commit": "9abcdef0", "device": {"name": "cuda", "model": "H100"}}
    assert provenance_columns([PART, other, PART]) == {
        "hardware": "Zen, 24 cores; Zen, 24 cores, name cuda, model H100",
        "versions": "python 3.12.1, numpy 2.4",
        "commit": "12345678; 9abcdef0",
    }
    assert joined(["a; b", None, "b", "c"]) == "a; b; c"
    assert joined([None]) is None


def test_a_comparison_has_success_rates_time_and_origin():
    study = STUDIES["fig3"]("smoke")
    summaries = {}
    for cell in study.cells:
        row = {"best_score": cell.seed, "best_success": cell.seed / 4, "seconds": 1800 * cell.seed}
        row |= provenance_columns([{**PART, "git_commit": str(cell.seed)}])
        summaries[cell.name] = CellResults(row={**cell.identity, **row}, curve=())
    first = compare(study, summaries)[0]
    assert (first.env, first.seeds) == ("point-gather", 2)
    assert (first.success_mean, first.hours) == (0.375, 0.75)
    assert first.success_error == pytest.approx(0.125)
    assert (first.hardware, first.commit) == ("Zen, 24 cores", "1; 2")
    only = {name: found for name, found in summaries.items() if name.endswith("seed-1")}
    assert compare(study, only)[0].success_error is None


def test_returns_of_the_primitive_are_drawn_for_forms_with_the_published_goals_alone():
    figure = STUDIES["fig3"]("laptop", 1).design.figures[-1]
    drawn = {(panel.env, panel.measure.column): [curve.variant for curve in panel.curves] for panel in figure.panels}
    for env, alike in {"point-gather": ["views", "branches", "ties"], "ant-gather": [*STEPS[:4]]}.items():
        assert drawn[env, "primitive_return_mean"] == ["published", *alike]
        assert drawn[env, "score_mean"] == ["published", *STEPS_OF[env[:3]], "pieces"]


PUBLISHED_FIRST = (("methods", "published"), ("methods", "pieces"))
STEPS = ("views", "symmetry", "branches", "gait", "goals", "equivariant")
STEPS_OF = {"ant": STEPS, "poi": ("views", "branches", "ties")}  # one change after another
COMPARED = {
    "table1": {
        PUBLISHED_FIRST,
        *((("methods", "published"), ("steps", step)) for step in (*STEPS, "ties")),
        (("methods", "published"), ("methods", "hiro")),
        (("methods", "hiro"), ("methods", "pieces")),
    },
    "fig4": {
        (("workers", "published-1"), ("workers", "published-2")),
        (("workers", "published-1"), ("workers", "pieces-1")),
        (("workers", "published-1"), ("workers", "pieces-2")),
        (("workers", "published-2"), ("workers", "pieces-2")),
        (("workers", "pieces-1"), ("workers", "pieces-2")),
    },
    "fig5": {
        PUBLISHED_FIRST,
        (("methods", "published"), ("transfer", "published")),
        (("methods", "published"), ("transfer", "pieces")),
        (("transfer", "published"), ("transfer", "pieces")),
        (("methods", "pieces"), ("transfer", "pieces")),
    },
}
COMPARED["fig3"] = COMPARED["table1"]


@pytest.mark.parametrize("name", COMPARED)
def test_every_question_of_an_experiment_has_one_row(name):
    study = STUDIES[name]("laptop")
    summaries = {
        cell.name: CellResults(row={**cell.identity, "best_score": cell.seed, "seconds": cell.seed}, curve=())
        for cell in study.cells
    }
    for env in study.design.metrics:
        found = [each for each in compare(study, summaries) if each.env == env and each.against]
        pairs = [((each.against_group, each.against), (each.group, each.variant)) for each in found]
        assert len(pairs) == len(set(pairs))
        variants = {(cell.group, cell.variant) for cell in study.cells if cell.env == env}
        own = () if name not in ("table1", "fig3") else STEPS_OF[env[:3]] if env.endswith("-gather") else ()
        steps = {(("steps", first), ("steps", second)) for first, second in itertools.pairwise(own)}
        steps |= {(("methods", "pieces"), ("steps", last)) for last in own[-1:]}
        assert set(pairs) == {pair for pair in COMPARED[name] if set(pair) <= variants} | steps
        assert len({each.texts(study.design)[:2] for each in found}) == len(found)
    design = study.design
    assert design.metrics["ant-maze"].column == ("seconds" if name == "fig4" else "best_score")
    assert (design.has_ratios, design.has_equal_budgets) == (name == "fig4", True)


# The command.


@pytest.fixture
def done(monkeypatch):
    """Let the runs of a study be in the tables, and nothing be drawn."""

    def no_runs(study, out, **__):
        out.mkdir(parents=True, exist_ok=True)
        measures = [each.column for each in (*study.design.metrics.values(), *study.design.curves.values())]
        # The experiments share runs, so that a run has what any of them compares or draws.
        others = ("best_score", "score_mean", "training_return_mean", "seconds", "env_steps")
        values = dict.fromkeys([*measures, *others], 1.0)
        rows_of = {cell.name: {**cell.identity, **values} for cell in study.cells}
        write_tables(study.ordered(), {name: CellResults(row=row, curve=(row,)) for name, row in rows_of.items()}, out)
        yield from ()

    monkeypatch.setattr(experiments, "run_study", no_runs)
    monkeypatch.setattr(experiments, "draw_figures", lambda *_: [])


def test_each_experiment_has_a_table_of_its_own_in_the_shared_folder(tmp_path, monkeypatch, done, capsys):
    monkeypatch.chdir(tmp_path)
    for name in NAMES:
        assert main(["experiment", name, "--scale", "smoke"]) == 0
    assert main(["experiment", "learning", "--scale", "smoke"]) == 0
    assert {path.name for path in (tmp_path / "runs" / "paper-smoke").glob("*.csv")} >= {
        f"{name}.csv" for name in NAMES
    }
    assert not (tmp_path / "runs" / "paper-smoke" / "comparison.csv").exists()
    assert (tmp_path / "runs" / "learning-smoke" / "comparison.csv").exists()
    assert "curves.csv, fig6.csv in runs/paper-smoke" in capsys.readouterr().out


def test_table_1_is_printed_beside_the_settings_here(tmp_path, done, capsys):
    assert main(["experiment", "table1", "--scale", "smoke", "--out", str(tmp_path)]) == 0
    lines = [line.split("│") for line in capsys.readouterr().out.splitlines() if "│" in line]
    printed = {cells[1].strip(): [cell.strip() for cell in cells[2:6]] for cells in lines}
    assert printed["sigma"] == ["0.02", "0.02", "-", "-"]
    assert printed["hours"] == ["10", "10.0", "10", "10.0"]
    assert [row["parameter"] for row in rows(tmp_path / "table1-settings.csv")] == [row.words for row in TABLE_1]
    assert main(["experiment", "table1", "--scale", "smoke", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["settings"] == settings_beside()


def test_fewer_seeds_than_the_tables_have_are_named(tmp_path, done, capsys):
    values = {"best_score": 1.0, "training_return_mean": 1.0, "score_mean": 1.0, "env_steps": 9, "seconds": 9.0}
    cells = STUDIES["fig5"]("smoke").ordered()
    rows_of = {cell.name: {**cell.identity, **values} for cell in cells}
    made = {name: CellResults(row=row, curve=(row,)) for name, row in rows_of.items()}
    write_tables(cells, made, tmp_path)
    for asked in (["--seeds", "1"], []):
        assert main(["experiment", "fig5", "--scale", "smoke", "--no-run", "--out", str(tmp_path), *asked]) == 0
        said = "Comparisons and figures are of 1 seed alone; runs.csv has more." in capsys.readouterr().out
        assert said == bool(asked)


# Figures.


@pytest.mark.extras
@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", NAMES)
def test_a_figure_is_built_from_the_tables_alone(tmp_path, name):
    study = STUDIES[name]("smoke", seeds=2)
    columns = {measure.column for each in (study.design.metrics, study.design.curves) for measure in each.values()}
    columns |= {"score_mean", "primitive_return_mean"}
    summaries = {
        cell.name: CellResults(
            row={**cell.identity, **dict.fromkeys(columns, cell.seed / 3), "env_steps": 99, "seconds": 7.5},
            curve=tuple(
                {
                    **cell.identity,
                    **dict.fromkeys(columns, (step + cell.seed) / 7),
                    "env_steps": 10 * step,
                    "seconds": 0.1 * step,
                    "kind": "projected",
                    "cores": step + 1,
                }
                for step in range(4)
            ),
        )
        for cell in study.cells
    }
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    write_tables(study.ordered(), summaries, second)
    again = read_summaries(study, second)
    drawn, redrawn = (
        {path.name: path.read_bytes() for path in draw_figures(study, found, compare(study, found), folder)}
        for found, folder in ((summaries, first), (again, second))
    )
    assert drawn == redrawn
    assert {name.rpartition(".")[-1] for name in drawn} == {"png", "svg"}
