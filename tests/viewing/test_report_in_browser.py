"""The page of a report as Chromium shows it."""

import importlib.util

import pytest

from shes.viewing.report import report
from tests.browser import Browser, find_browser

pytestmark = [
    pytest.mark.extras,
    pytest.mark.skipif(importlib.util.find_spec("plotly") is None, reason="needs plotly (extra report)"),
]
FIRST = "document.querySelector('.plot')"
FAULTS = """(() => {
  const rect = (each) => each.getBoundingClientRect();
  const found = [];
  const meets = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom - 1 && b.top < a.bottom - 1;
  for (const plot of document.querySelectorAll('.js-plotly-plot')) {
    const titles = [...plot.querySelectorAll('text[class^=x][class$=title]')];
    for (const each of plot.querySelectorAll('g[class^=x][class$=tick] text, .legend'))
      if (titles.some((title) => meets(rect(title), rect(each)))) found.push(`a title covers ${each.textContent}`);
    for (const text of plot.querySelectorAll('.main-svg text')) {
      const inner = rect(text), outer = rect(plot);
      if (text.textContent && inner.width && (inner.left < outer.left - 1 || inner.right > outer.right + 1 ||
          inner.top < outer.top - 1 || inner.bottom > outer.bottom + 1)) found.push(`${text.textContent} is cut`);
    }
  }
  for (const each of document.querySelectorAll('h1, h2, h3, summary, .note'))
    if (each.scrollWidth > each.clientWidth && each.clientWidth) found.push(`${each.textContent} is too wide`);
  for (const each of document.querySelectorAll('table'))
    if (rect(each.parentElement).right > innerWidth) found.push('a table is wider than the window');
  return found;
})()"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The page of two shipped agents and of a shipped walker."""
    folder = tmp_path_factory.mktemp("whole")
    return report(["ant-gather", "ant-gather-coevolved", "ant-walker"], folder / "report.html", episodes=2, video=False)


@pytest.fixture
def browser(tmp_path):
    binary = find_browser()
    if binary is None:
        pytest.skip("there is no Chromium here")
    with Browser(binary, tmp_path / "profile") as opened:
        yield opened
        assert opened.errors == []
        assert not [url for url in opened.requests if not url.startswith(("file:", "data:", "blob:"))]


def test_the_horizontal_axis_and_the_curves_can_be_chosen(page, browser):
    browser.open(page)
    browser.wait_for(f"{FIRST}.querySelector('.updatemenu-button')")
    shown = f"{FIRST}._fullData.filter((trace) => trace.visible === true)"

    def click(selector, number):
        event = "new MouseEvent('{}', {{bubbles: true}})"
        target = f"{FIRST}.querySelectorAll('{selector}')[{number}]"
        for kind in ("mousedown", "mouseup", "click"):
            browser.evaluate(f"{target}.dispatchEvent({event.format(kind)}) && null")

    for number, x in enumerate(("env_steps", "wall_time_s", "generation")):
        click(".updatemenu-button", number)
        browser.wait_for(f"{shown}.every((trace) => trace.meta === '{x}')")
    names = f"[...new Set({shown}.map((trace) => trace.legendgroup))].length"
    assert browser.evaluate(names) == 2
    click(".legendtoggle", 0)
    browser.wait_for(f"{names} === 1")


@pytest.mark.parametrize("width", [1400, 700])
def test_the_page_fits_its_window(page, browser, width):
    browser.open(page, width)
    count = browser.evaluate("document.querySelectorAll('.plot').length")
    browser.wait_for(f"document.querySelectorAll('.js-plotly-plot .main-svg').length >= {count}")
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    assert browser.evaluate(FAULTS) == []
