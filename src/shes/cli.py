"""The `shes` command. Parses, prints, and turns errors into one line and an exit code; the work is done elsewhere."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import tyro
from rich.console import Console
from rich.table import Table

from shes.envs.registry import ENVIRONMENTS
from shes.errors import ConfigError, ShesError, UnknownNameError
from shes.experiments.config import TrainConfig
from shes.experiments.presets import PRESETS, make_config
from shes.experiments.progress import ProgressDisplay

__all__ = ["main"]

INTERRUPTED = 130
"""Exit code after Ctrl-C."""

_ALIASES = {"--workers": "--num-workers"}
Positional = tyro.conf.Positional
T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class EvaluateArguments:
    """Evaluate a checkpoint of a run on fresh episodes, without noise."""

    run: Positional[Path]
    """The run folder."""
    episodes: int = 50
    """Number of episodes."""
    checkpoint: str = "best"
    """best, last, or the number of a generation."""
    num_workers: int = 0
    """Worker processes; 0 is one for every core. Short: --workers."""
    seed: int | None = None
    """Seed of the episodes; a stream of the run's own, apart from its training, if none."""
    json: bool = False
    """Print one JSON object."""


@dataclass(frozen=True, kw_only=True)
class ResumeArguments:
    """Go on with a run as if it had never stopped."""

    run: Positional[Path]
    """The run folder."""
    generations: int | None = None
    """New last generation."""
    minutes: float | None = None
    """Minutes after which this call ends."""
    num_workers: int | None = None
    """Worker processes; 0 is one for every core. Short: --workers."""
    backend: str | None = None
    """processes or serial."""
    chunk_size: int | None = None
    """Policies that a worker runs in lockstep; 0 chooses."""
    keep_checkpoints: int | None = None
    """Generations between checkpoints that are kept."""


@dataclass(frozen=True, kw_only=True)
class PlotArguments:
    """Draw the learning curves of runs; runs that differ in the seed alone become a mean with a 95 % interval."""

    runs: Positional[tuple[Path, ...]]
    """Run folders."""
    out: Path = Path("curves.png")
    """The picture: .png, .pdf or .svg."""
    x: str = "env_steps"
    """What to draw over: env_steps, generation or wall_time_s."""


@dataclass(frozen=True, kw_only=True)
class EnvsArguments:
    """List the environments."""

    json: bool = False
    """Print a JSON array of objects."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code: 0, 2 for what the user can mend, 1 for the rest, 130 after Ctrl-C."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [_ALIASES.get(word, word) for word in words if word != "--debug"]
    words = [
        f"{_ALIASES[name]}={value}" if name in _ALIASES else word
        for word in words
        for name, _, value in [word.partition("=")]
    ]
    try:
        return _dispatch(words)
    except KeyboardInterrupt:
        _error_console().print("Interrupted.", style="yellow")
        return INTERRUPTED
    except ShesError as error:
        if debug:
            raise
        _error_console().print(f"[bold red]Error:[/bold red] {_escape(str(error))}", highlight=False, soft_wrap=True)
        return error.exit_code
    except OSError as error:  # standard output is a full disk or a closed pipe, a path cannot be read, ...
        if debug:
            raise
        _error_console().print(f"[bold red]Error:[/bold red] {_escape(str(error))}", highlight=False, soft_wrap=True)
        return ConfigError.exit_code


def _quote(path: Path) -> str:
    """Return `path` as a word of a command that can be copied into a shell."""
    return shlex.quote(str(path))


def _escape(text: str) -> str:
    """Return `text` so that rich prints it as it is."""
    return text.replace("[", "\\[")


def _error_console() -> Console:
    return Console(stderr=True)


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("-h", "--help", "help"):
        print(_usage())
        return 0
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"shes {version('shes')}")
        return 0
    if words[0] not in _COMMANDS:
        raise UnknownNameError("command", words[0], _COMMANDS, "`shes --help` explains them.")
    return _COMMANDS[words[0]][0](words[1:])


def _usage() -> str:
    """Return the help of the command without a subcommand."""
    width = max(len(name) for name in _COMMANDS)
    lines = [f"  {name:<{width}}  {text}" for name, (_, text) in _COMMANDS.items()]
    return "\n".join(
        [
            "usage: shes COMMAND ...",
            "",
            "Scalable hierarchical evolution strategies: train, look, measure.",
            "",
            *lines,
            "",
            "`shes COMMAND --help` lists the flags of a command. --debug shows the traceback of an error.",
            "First steps: shes train point-gather --generations 60, then shes plot RUN, then shes train ant-gather.",
        ]
    )


def _parse(kind: type[T], command: str, words: list[str], default: Any = None) -> T:
    """Return the arguments of `command`; prints help or an error and leaves (exit code 0 or 2) where tyro does."""
    extra = {} if default is None else {"default": default}
    return tyro.cli(kind, prog=f"shes {command}", args=words, description=kind.__doc__, **extra)


def _split_option(words: list[str], name: str) -> tuple[str | None, list[str]]:
    """Return the value of `--name VALUE` or `--name=VALUE`, if it is there, and the other words.

    Raises:
        ConfigError: The flag has no value.
    """
    rest: list[str] = []
    value: str | None = None
    queue = list(words)
    while queue:
        word = queue.pop(0)
        if word == name:
            if not queue or queue[0].startswith("--"):
                raise ConfigError(f"{name} needs a value.")
            value = queue.pop(0)
        elif word.startswith(f"{name}="):
            value = word.partition("=")[2]
        else:
            rest.append(word)
    return value, rest


def _config(words: list[str], command: str) -> TrainConfig:
    """Return the settings that `[ENV] --preset NAME --any-setting ...` ask for."""
    preset, rest = _split_option(words, "--preset")
    env = rest.pop(0) if rest and not rest[0].startswith("-") else None
    if env is None and not {"-h", "--help"} & set(rest):
        raise ConfigError(
            f"shes {command} needs an environment first: shes {command} {next(iter(ENVIRONMENTS))}. "
            f"Environments: {', '.join(ENVIRONMENTS)}."
        )
    default = make_config(env or "ant-gather", preset or "laptop")
    for word in rest:
        if word.partition("=")[0] == "--env":
            raise ConfigError(f"the environment comes first, without a flag: shes {command} ENV; got {word}.")
    print_help = {"-h", "--help"} & set(rest)
    if print_help:
        print(
            f"usage: shes {command} ENV [--preset {{{','.join(PRESETS)}}}] [--SETTING VALUE ...]\n"
            f"ENV: {', '.join(ENVIRONMENTS)}. The values shown are those of the preset {default.preset!r}.\n"
        )
    return _parse(TrainConfig, f"{command} {env or 'ENV'}", rest, default)


def _train(words: list[str]) -> int:
    """Train and say what came of it."""
    from shes.experiments.train import start_run

    out, rest = _split_option(words, "--out")
    config = _config(rest, "train")
    return _show(lambda display: start_run(config, out, display))


def _resume(words: list[str]) -> int:
    """Go on with a run."""
    from shes.experiments.train import resume

    arguments = _parse(ResumeArguments, "resume", words)
    settings = {name: value for name, value in vars(arguments).items() if name != "run" and value is not None}
    return _show(lambda display: resume(arguments.run, listener=display, **settings))


def _show(work: Callable[[ProgressDisplay], Any]) -> int:
    """Run `work` with a progress display; after Ctrl-C, say how to go on."""
    console = Console()
    display = ProgressDisplay(console)
    try:
        with display:
            run = work(display)
    except KeyboardInterrupt:
        if display.path is not None:
            console.print(
                "Stopped; everything up to the last finished generation is kept. "
                f"Go on: shes resume {_quote(display.path)}",
                highlight=False,
                markup=False,
                soft_wrap=True,
            )
        raise
    best = "no evaluation yet"
    if run.best.generation >= 0:
        best = f"best evaluation score {run.best.score:.2f} (generation {run.best.generation})"
    path = _quote(run.path)
    console.print(
        f"Done: {run.generation} generations, {best}.\nNext: shes evaluate {path} · shes plot {path}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )
    return 0


def _evaluate(words: list[str]) -> int:
    """Evaluate and print a table or JSON."""
    from shes.experiments.evaluate import evaluate

    arguments = _parse(EvaluateArguments, "evaluate", words)
    found = evaluate(
        arguments.run,
        episodes=arguments.episodes,
        checkpoint=arguments.checkpoint,
        num_workers=arguments.num_workers,
        seed=arguments.seed,
    )
    _print_facts({"run": str(arguments.run), "checkpoint": arguments.checkpoint, **found.summary()}, arguments.json)
    return 0


def _plot(words: list[str]) -> int:
    """Draw and say where."""
    from shes.experiments.plot import plot

    arguments = _parse(PlotArguments, "plot", words)
    print(f"Learning curves: {plot(arguments.runs, arguments.out, x=arguments.x)}")
    return 0


def _envs(words: list[str]) -> int:
    """List the environments with their dimensions."""
    from shes.envs.registry import make_task

    arguments = _parse(EnvsArguments, "envs", words)
    rows = []
    for name in ENVIRONMENTS:
        task = make_task(name, 1)
        what = " ".join((type(task).__doc__ or "").split("\n\n", maxsplit=1)[0].split())
        rows.append({"name": name, "observation": task.observation_size, "action": task.action_size, "task": what})
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return 0
    table = Table("environment", "observation", "action", "task")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    Console().print(table)
    return 0


def _bench(words: list[str]) -> int:
    """Measure and print a table or JSON."""
    from shes.experiments.bench import bench_rollout, bench_update

    benches = {"rollout": bench_rollout, "update": bench_update}
    if not words or words[0] in ("-h", "--help"):
        print(
            "usage: shes bench {rollout,update} [ENV] [--preset NAME] [--SETTING VALUE ...] [--json]\n\n"
            "rollout  steps per second of whole generations against a bare mj_step loop on the same episodes\n"
            "update   milliseconds of the parent's work between generations, by part\n\n"
            "ENV is ant-gather if none is given; settings are those of `shes train`."
        )
        return 0
    name, *rest = words
    if name not in benches:
        raise UnknownNameError("bench", name, benches, "`shes bench --help` explains them.")
    as_json = "--json" in rest
    rest = [word for word in rest if word != "--json"]
    if not rest or rest[0].startswith("-"):
        rest.insert(0, "ant-gather")
    _print_facts(benches[name](_config(rest, f"bench {name}")), as_json)
    return 0


def _print_facts(facts: dict[str, Any], as_json: bool) -> None:
    """Print named values as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(facts))
        return
    table = Table(show_header=False)
    for name, value in facts.items():
        table.add_row(name, f"{value:,.3f}" if isinstance(value, float) else str(value))
    Console().print(table)


_COMMANDS: dict[str, tuple[Callable[[list[str]], int], str]] = {
    "envs": (_envs, "list the environments"),
    "train": (_train, "train on an environment"),
    "resume": (_resume, "go on with a run, to the bit"),
    "evaluate": (_evaluate, "evaluate a checkpoint of a run on fresh episodes"),
    "plot": (_plot, "draw the learning curves of runs"),
    "bench": (_bench, "measure how fast this machine is"),
}


if __name__ == "__main__":
    sys.exit(main())
