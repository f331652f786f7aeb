"""The model card states the scores of all controllers, seed, steps and command."""

import re

import pytest

import shes
from shes.cli import main
from shes.runs import listings
from shes.runs.shipped import read_agent


@pytest.mark.parametrize("name", ["ant-gather", "ant-walker"])
def test_the_card_of_a_shipped_agent_has_its_stored_scores(capsys, name):
    assert main(["info", name, "--card"]) == 0
    text, agent = capsys.readouterr().out, read_agent(name)
    for each in filter(None, agent.evaluations):
        assert f"| {each.controller or 'none'} | {each.score} | {100 * each.success_rate:.0f} % |" in text
    for expected in (f'value: "{agent.evaluation.score}"', f"{agent.env_steps:,} environment", agent.commands[-1]):
        assert expected in text
    assert "<video" not in text


def test_the_card_of_a_run_has_scores_of_fresh_episodes(run_copy, monkeypatch, capsys):
    monkeypatch.setattr(listings, "CARD_EPISODES", 3)
    (run_copy / "replay.mp4").touch()
    assert main(["info", str(run_copy), "--card"]) == 0
    text = capsys.readouterr().out
    for name in ("trained", "constant", "random"):
        found = shes.evaluate(run_copy, episodes=3, controller=name)
        assert f"| {found.controller} | {found.scores.mean():.2f} ± " in text
    lines = r"- seed \d+, [\d,]+ environment steps, \d+ generations\n- trained by `.+`\n\n<video .*replay"
    assert re.search(lines, text)
