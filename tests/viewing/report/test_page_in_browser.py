"""The page of a report as Chromium shows it: of shipped agents, and of an experiment."""

import importlib.util
import json
import re
import time

import pytest

from shes.drawing.opengl import find_opengl
from shes.studies.experiment import experiment as run_experiment
from shes.studies.named_studies import STUDIES
from shes.studies.paper_scales import REFERENCES
from shes.studies.report_design import write_report_design
from shes.viewing.report.report import report
from tests.browser import Browser, find_browser
from tests.viewing.report.elements import Elements

pytestmark = [
    pytest.mark.extras,
    pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="needs plotly (extra report)"),
]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The page of two shipped agents and of a shipped walker."""
    folder = tmp_path_factory.mktemp("whole")
    return report(["ant-gather", "ant-gather-coevolved", "ant-walker"], folder / "report.html", episodes=4, video=False)


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    """The page of figure 5 at scale smoke with one task, and of rows of figures 3, 4 and 6 in the same folder."""
    folder = tmp_path_factory.mktemp("experiment") / "paper"
    run_experiment("fig5", scale="smoke", seeds=1, only=["point-gather"], out=folder, num_workers=1)
    for name in ("fig3", "fig4", "fig6"):
        write_report_design(name, STUDIES[name]("paper" if name == "fig4" else "laptop"), name, folder)
    columns, *rows = (folder / "curves.csv").read_text(encoding="utf-8").splitlines()
    of_curves = [
        (group, variant, "ant-gather", seed, 1000 * step, 60 * step, seed * (-1) ** step, step)
        for group, variants in (("methods", ("published", "hiro")), ("workers", ("pieces-48", "pieces-600")))
        for variant in variants
        for seed in (1, 2)
        for step in range(1, 4)
    ]
    names = ("group", "variant", "env", "seed", "env_steps", "seconds", "score_mean", "training_return_mean")
    new = [dict(zip(names, row, strict=True)) for row in of_curves]
    new += [
        {**dict(zip(names, ("speedup", variant, "ant-maze", 1), strict=False)), "kind": kind, "cores": c, "speedup": c}
        for variant in ("published", "pieces", "es")
        for kind in ("measured", "projected", "asleep")
        for c in (1, 10, 600)
    ]
    every = [*columns.split(","), "kind", "cores", "speedup"]
    rows = [f"{row},,," for row in rows] + [",".join(str(row.get(name, "")) for name in every) for row in new]
    (folder / "curves.csv").write_text("\n".join([",".join(every), *rows]) + "\n", encoding="utf-8")
    return report([folder], folder.parent / "report.html", episodes=2, num_workers=1, video=False)


@pytest.mark.parametrize("which", ["whole", "experiment"])
def test_plotly_knows_every_figure(which, request):
    from plotly.graph_objects import Figure

    figures = Elements(request.getfixturevalue(which)).figures["figures"]
    assert len(figures) > 20
    for each in figures.values():
        for figure in [each] if "data" in each else each.values():
            text = re.sub(r'"--[a-z0-9-]+(/[\d.]+)?"', '"red"', json.dumps(figure))
            Figure(json.loads(text))  # raises for a wrong name or value


@pytest.fixture
def browser(tmp_path):
    binary = find_browser()
    if binary is None:
        pytest.skip("there is no Chromium here")
    with Browser(binary, tmp_path / "profile") as opened:
        yield opened


FIRST = "document.querySelector('[data-figure]')"


def first_plot(browser):
    """Scroll to the first figure; return the sides of its area: left, top, right and bottom in pixels."""
    browser.evaluate(f"{FIRST}.scrollIntoView({{block: 'center'}})")
    browser.wait_for(f"{FIRST}.querySelector('.nsewdrag')")
    area = f"{FIRST}.querySelector('.nsewdrag').getBoundingClientRect()"
    return browser.evaluate(f"(() => {{const r = {area}; return [r.left, r.top, r.right, r.bottom]}})()")


def test_values_are_shown_below_the_mouse_and_a_drag_zooms(whole, browser):
    browser.open(whole)
    left, top, right, bottom = first_plot(browser)
    middle = (top + bottom) / 2
    browser.mouse("Moved", left + 10, middle)
    browser.mouse("Moved", (left + right) / 2, middle)
    shown = browser.wait_for(f"{FIRST}.querySelector('.hoverlayer').textContent")
    assert re.search(r"\d\.\d", shown)
    across = f"{FIRST}._fullLayout.xaxis.range"
    before = browser.evaluate(across)
    browser.drag((left + 0.4 * (right - left), middle), (left + 0.6 * (right - left), middle))
    after = browser.wait_for(f"{FIRST}._fullLayout.xaxis.autorange === false && {across}")
    assert after[1] - after[0] == pytest.approx(0.2 * (before[1] - before[0]), rel=0.1)
    assert browser.errors == []
    assert not [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))]


def test_the_horizontal_axis_the_curves_and_the_episode_can_be_chosen(whole, browser):
    browser.open(whole)
    first_plot(browser)
    title = f"{FIRST}._fullLayout.xaxis.title.text"
    for x, label in (("generation", "generation"), ("wall_time_s", "minutes")):
        browser.evaluate(f"document.querySelector('input[value={x}]').click()")
        assert browser.wait_for(f"{title} === '{label}' && {title}")
    curves = f"{FIRST}.data.filter((trace) => trace.name).length"
    count = browser.evaluate(curves)
    browser.evaluate("document.querySelector('#legend button').click()")
    assert browser.evaluate(curves) == count - 1
    place = "document.querySelector('[data-figure=\"map 0\"]')"
    browser.evaluate(f"{place}.scrollIntoView()")
    browser.wait_for(f"{place}.data")
    numbers = f"[...new Set({place}.data.map((trace) => trace.meta.episode))]"
    assert browser.evaluate(numbers) == [0, 1, 2, 3]
    choice = "document.querySelector('select[data-map=\"map 0\"]')"
    browser.evaluate(f"{choice}.value = '2'; {choice}.dispatchEvent(new Event('change'))")
    assert browser.wait_for(f"{place}.data.some((trace) => trace.meta.alone) && {numbers}") == [2]
    assert browser.errors == []


def test_a_video_plays(tiny_run, browser, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "off")  # the drawing without it is the fastest
    find_opengl.cache_clear()
    page = report(tiny_run, tmp_path / "report.html", episodes=1, num_workers=1)
    find_opengl.cache_clear()
    browser.open(page)
    video = "document.querySelector('video')"
    browser.evaluate(f"{video}.muted = true; {video}.play()")
    assert browser.wait_for(f"{video}.currentTime > 0 && {video}.videoWidth") > 100
    assert browser.errors == []


def open_details(browser):
    browser.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")


def figure_of(title):
    """Return an expression for the place of the figure with this name."""
    return f"[...document.querySelectorAll('[data-figure]')].find((box) => box.dataset.figure.endsWith('{title}'))"


def test_an_experiment_comes_first_with_its_names_in_words(experiment, browser):
    browser.open(experiment, 1400)
    headings = browser.evaluate("[...document.querySelectorAll('h2')].map((each) => each.textContent)")
    assert headings[0].startswith("Experiment ")
    assert headings[1:4] == ["Runs", "Fresh episodes", "Map"]
    assert browser.evaluate(f"{FIRST}.closest('section').querySelector('h2').textContent") == headings[0]
    assert not browser.evaluate("[...document.querySelectorAll('details')].some((each) => each.open)")
    open_details(browser)
    chips = browser.evaluate("[...document.querySelectorAll('#legend button')].map((each) => each.textContent)")
    assert chips == [
        f"{group}, {form}"
        for group in ("methods", "transfer")
        for form in ("as published, small", "with the learning changes")
    ]
    maps = browser.evaluate("[...document.querySelectorAll('.card:has(select) h3')].map((each) => each.textContent)")
    assert set(maps) == {
        *(f"point-gather: {chip}, seed 1" for chip in chips),
        *(f"point-flagrun: {chip}, seed 1" for chip in chips[2:]),
    }
    table = "document.querySelector('section .figures')"
    names = browser.evaluate(f"[...{table}.querySelectorAll('tbody td:nth-child(2)')].map((each) => each.textContent)")
    assert set(names) == set(chips)
    assert browser.errors == []


def test_the_curves_of_an_experiment_are_read_below_the_mouse_and_its_running_best_is_toggled(experiment, browser):
    browser.open(experiment)
    chart = figure_of("Ant Gather: test score")
    browser.evaluate(f"{chart}.scrollIntoView({{block: 'center'}})")
    browser.wait_for(f"{chart}.querySelector('.nsewdrag')")
    area = f"{chart}.querySelector('.nsewdrag').getBoundingClientRect()"
    left, top, right, bottom = browser.evaluate(
        f"(() => {{const r = {area}; return [r.left, r.top, r.right, r.bottom]}})()"
    )
    browser.mouse("Moved", left + 10, (top + bottom) / 2)
    browser.mouse("Moved", right - 10, (top + bottom) / 2)
    assert "SHES as published, small (2 seeds)" in browser.wait_for(f"{chart}.querySelector('.hoverlayer').textContent")

    def click(name):
        time.sleep(0.5)  # plotly takes two clicks within 0.3 s as one double click
        entry = f"[...{chart}.querySelectorAll('.traces')].find((each) => each.textContent.startsWith('{name}'))"
        place = f"{entry}.querySelector('.legendtoggle').getBoundingClientRect()"
        x, y = browser.evaluate(f"(() => {{const r = {place}; return [r.x + r.width / 2, r.y + r.height / 2]}})()")
        browser.mouse("Moved", x, y)
        browser.mouse("Pressed", x, y, button="left", clickCount=1)
        browser.mouse("Released", x, y, button="left", clickCount=1)

    shown = (
        f"{chart}._fullData.filter((each) => each.visible === true && each._input.name).map((each) => each.name).join()"
    )
    curves = ["SHES as published, small (2 seeds)", "HIRO, small (2 seeds)"]
    best = [f"{curve}, running best" for curve in curves]
    entry = "running best, as the authors plot it"
    references = [f"{words}: {value:g}" for words, value in REFERENCES["ant-gather"]]
    assert browser.evaluate(shown) == ",".join([*curves, *best, entry, *references])
    click(entry)
    browser.wait_for(f"{shown} === '{','.join([*curves, *references])}'")
    click(curves[1])
    browser.wait_for(f"{shown} === '{','.join([curves[0], *references])}'")
    click(entry)
    browser.wait_for(f"{shown} === '{','.join([curves[0], best[0], entry, *references])}'")
    click(curves[1])
    browser.wait_for(f"{shown} === '{','.join([*curves, *best, entry, *references])}'")
    click(curves[1])
    browser.wait_for(f"{shown} === '{','.join([curves[0], best[0], entry, *references])}'")
    assert browser.errors == []


FAULTS = """(() => {
  const rect = (each) => each.getBoundingClientRect();
  const within = (inner, outer) => inner.left >= outer.left - 1 && inner.right <= outer.right + 1 &&
    inner.top >= outer.top - 1 && inner.bottom <= outer.bottom + 1;
  const meets = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  const found = [];
  for (const plot of document.querySelectorAll('.js-plotly-plot')) {
    const name = plot.dataset.figure, bar = rect(plot.querySelector('.modebar-group'));
    const texts = [...plot.querySelectorAll('.main-svg text')].filter((each) => each.textContent && rect(each).width);
    for (const text of texts) {
      if (!within(rect(text), rect(plot))) found.push(`${name}: ${text.textContent} is cut`);
      if (meets(rect(text), bar)) found.push(`${name}: ${text.textContent} lies under the mode bar`);
    }
    const caption = plot.previousElementSibling, legend = plot.querySelector('g.legend');
    if (meets(rect(caption), bar)) found.push(`${name}: the title lies under the mode bar`);
    if (caption.matches('figcaption') && !caption.textContent) found.push(`${name} has no title`);
    const label = plot.querySelector('.xtitle');
    if (legend && label && meets(rect(label), rect(legend))) found.push(`${name}: the legend covers the axis`);
  }
  for (const each of document.querySelectorAll('figcaption, h2, h3, summary, #legend button, .note'))
    if (each.scrollWidth > each.clientWidth && each.clientWidth)
      found.push(`${each.textContent} is wider than its box`);
  for (const each of document.querySelectorAll('table'))
    if (rect(each.parentElement).right > innerWidth) found.push('a table is wider than the window');
  return found;
})()"""


@pytest.mark.parametrize("width", [1400, 420])
@pytest.mark.parametrize("is_dark", [False, True])
@pytest.mark.parametrize("which", ["whole", "experiment"])
def test_the_page_fits_its_window_and_follows_its_scheme(which, request, browser, width, is_dark):
    browser.open(request.getfixturevalue(which), width, is_dark=is_dark)
    open_details(browser)
    count = browser.evaluate("document.querySelectorAll('[data-figure]').length")
    drawn = "Promise.all([...document.querySelectorAll('[data-figure]')].map(draw))"
    browser.evaluate(f"{drawn}.then(() => document.fonts.ready).then(() => true)")
    assert browser.evaluate("document.querySelectorAll('.js-plotly-plot').length") == count
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate(FAULTS) == []
    ink = browser.evaluate("getComputedStyle(document.body).color")
    text = browser.evaluate(f"getComputedStyle({FIRST}.querySelector('.xtitle')).fill")
    assert text == ink
    assert (sum(map(int, re.findall(r"\d+", ink))) > 3 * 128) is is_dark
    assert browser.errors == []
