"""Every page can be read in a real browser: on a phone, on a desk, on paper, offline."""

from __future__ import annotations

import base64
import csv
import io
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from benchmarks import peers, ranks, sizes, step
from browser import Browser, browser, needs_chromium
from made_drops import QUICK, write_drops
from made_outcomes import (
    growing,
    points_of_every_program,
    shared_out,
    steps,
)
from small_reproduction import reproduced

from bristle.solver.effects.library import EFFECTS
from bristle.studies.cli import main
from bristle.studies.loop.kinds.drops import problem as drops_module

pytestmark = [pytest.mark.serial, needs_chromium]

COMMANDS = ("reproduce", "close-loop", "scatter", "brush", "calibrate", "calibrate-paper")
BENCHES = ("peers", "step", "sizes", "ranks")
PAGES = (*COMMANDS, *BENCHES)
PHONE, DESK = 390, 1280
# A4 between the margins.
SHEET = 688
TITLE = "<img src=x onerror=alert(1)> drops"
# CSS pixels: text to read, text in a drawing, and what a finger must hit (WCAG 2.2, 2.5.8).
TEXT_PX, LABEL_PX, TARGET_PX = 14.0, 7.0, 24.0

FIGURES = """
[...document.querySelectorAll('figure')].map(figure => {
  const svg = figure.querySelector(':scope > svg'), box = svg.getBoundingClientRect()
  const all = [...svg.querySelectorAll('text')]
  const labels = all.filter(text => /[a-z]/i.test(text.textContent))
  const scale = box.width / svg.viewBox.baseVal.width
  const size = label => parseFloat(getComputedStyle(label).fontSize) * scale
  const inside = label => {
    const it = label.getBoundingClientRect()
    return it.left >= box.left - 1 && it.right <= box.right + 1
  }
  return {
    name: figure.id,
    width: box.width, height: box.height, left: box.left, right: box.right,
    labels: labels.length,
    smallest: Math.min(...labels.map(size)),
    cut: labels.filter(label => !inside(label)).map(label => label.textContent),
    title: svg.querySelector('title').textContent,
    caption: figure.querySelector('figcaption').textContent,
    links: [...figure.querySelectorAll('a[download]')].map(link => link.href),
    command: figure.querySelector('code').textContent,
  }
})
"""
LINKS = "[...document.querySelectorAll('a')].map(a => [a.getAttribute('href'), a.download])"
TARGETS = """
[...document.querySelectorAll('a, summary')].filter(each => each.checkVisibility())
  .map(each => [each.textContent, each.getBoundingClientRect().height])
"""
TEXT = """
[...document.querySelectorAll('p, li, dd, td, figcaption')].filter(each => each.checkVisibility())
  .map(each => parseFloat(getComputedStyle(each).fontSize))
"""
WIDE = """
[...document.querySelectorAll('body *')].filter(each => !each.closest('svg, .scroll'))
  .filter(each => each.getBoundingClientRect().right > innerWidth + 0.5)
  .map(each => each.outerHTML.slice(0, 80))
"""


@pytest.fixture(scope="session")
def pages(tmp_path_factory) -> Path:
    """A folder with a result of every kind that has a page."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "reproduce").symlink_to(reproduced(tmp_path_factory)[0])
    drops = write_drops(folder / "drops", [EFFECTS["wear"](decades=2.0)], TITLE)
    few = ["--drops", "60", "--model", "beam", "--elements", "4"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drops_module, "carried", lambda kind, quantities: list(QUICK))
        for command, *rest in (
            ["close-loop", str(drops)],
            ["scatter", *few],
            ["brush", "--until", "0.02", "--elements", "5"],
            ["calibrate", str(drops)],
        ):
            assert main([command, *rest, "--out", str(folder / command)]) == 0
    assert main(["calibrate", "paper", "--out", str(folder / "calibrate-paper")]) == 0
    for bench in BENCHES:
        (folder / bench).mkdir()
    found, converged, runs = points_of_every_program()
    about = [("Machine", "none")]
    peers.page(found, converged, runs, folder / "peers", 5, about)
    step.page(steps(), folder / "step", 3, about)
    sizes.page(growing(), [], folder / "sizes", 200_000, about)
    lines, machine, memory = shared_out()
    ranks.page(lines, machine, memory, folder / "ranks", 3, about)
    return folder


@pytest.fixture(scope="session")
def tab() -> Iterator[Browser]:
    with browser() as opened:
        yield opened


@pytest.fixture(params=[(name, width) for name in PAGES for width in (PHONE, DESK)], ids=str)
def shown(request, pages, tab) -> tuple[Browser, Path, int]:
    """The browser with a page open at a width."""
    name, width = request.param
    tab.open(pages / name / "report.html", width)
    return tab, pages / name, width


def test_the_browser_complains_of_nothing_and_asks_for_nothing(shown):
    tab, folder, _ = shown
    assert tab.complaints() == []
    assert tab.requests() == [(folder / "report.html").resolve().as_uri()]


def test_the_page_is_as_wide_as_the_window(shown):
    tab, _, width = shown
    assert tab.run("innerWidth") == width
    assert tab.run(WIDE) == []
    assert tab.run("document.scrollingElement.scrollWidth") <= width


def test_text_can_be_read_and_links_hit(shown):
    tab, _, width = shown
    assert min(tab.run(TEXT)) >= TEXT_PX
    if width == PHONE:
        assert [text for text, height in tab.run(TARGETS) if height < TARGET_PX] == []


def test_every_figure_is_whole_and_has_caption_numbers_and_command(shown):
    tab, folder, width = shown
    figures = tab.run(FIGURES)
    assert len(figures) == len(list((folder / "figures").glob("*.svg")))
    for figure in figures:
        assert figure["width"] > 0.4 * min(width, 800), figure["name"]
        assert figure["height"] > 50, figure["name"]
        assert figure["left"] >= -0.5, figure["name"]
        assert figure["right"] <= width + 0.5, figure["name"]
        assert figure["labels"] >= 2, figure["name"]
        assert figure["smallest"] >= LABEL_PX, figure["name"]
        assert figure["cut"] == [], figure["name"]
        assert len(figure["caption"].split()) >= 3
        assert len(figure["title"].split()) >= 3
        assert re.match(r"(bristle|python3 -m bristle\.\S+) ", figure["command"] + " ")
        assert len(figure["links"]) == 1


def test_every_link_leads_somewhere(shown):
    tab, folder, _ = shown
    for address, download in tab.run(LINKS):
        if address.startswith("#"):
            assert tab.run(f"document.getElementById({address[1:]!r}) !== null"), address
            continue
        content = tab.run(f"fetch({address!r}).then(answer => answer.text())")
        assert content == (folder / "tables" / download).read_text()
        assert len(list(csv.reader(io.StringIO(content)))) >= 2, download


def test_on_paper_there_is_all_but_what_is_only_for_a_screen(pages, tab):
    for name in PAGES:
        tab.open(pages / name / "report.html", SHEET)
        tab.ask("Emulation.setEmulatedMedia", media="print")
        hidden = tab.run(
            "[...document.querySelectorAll('figure > svg, figcaption, .behind, pre, table')]"
            ".filter(each => !each.checkVisibility() && !each.closest('details')).length"
        )
        cut = tab.run(WIDE.replace("svg, .scroll", "svg"))
        cards = tab.run(
            "[...document.querySelectorAll('.compare tr')]"
            ".filter(row => getComputedStyle(row).display !== 'table-row').length"
        )
        tab.ask("Emulation.setEmulatedMedia", media="")
        assert (hidden, cut, cards) == (0, [], 0), name
        sheets = tab.print()
        assert sheets.startswith(b"%PDF")
        assert len(re.findall(rb"/Type\s*/Page\b", sheets)) >= 1


def test_a_title_is_words_and_nothing_else(pages, tab):
    tab.open(pages / "close-loop" / "report.html", DESK)
    assert TITLE in tab.run("document.querySelector('h1').textContent")
    assert tab.run("document.querySelectorAll('img, script, iframe').length") == 0


def test_the_browser_sees_what_is_wrong(tab, tmp_path):
    page = tmp_path / "wrong.html"
    gone = base64.b64encode(b"console.warn('so'); nothing.at.all").decode()
    page.write_text(
        '<!DOCTYPE html><body><div style="width:900px">wide</div><img src="gone.png">'
        f'<script src="data:text/javascript;base64,{gone}"></script>'
    )
    tab.open(page, 800)
    said = " ".join(tab.complaints())
    assert "so" in said
    assert "nothing is not defined" in said
    assert "gone.png" in said or "ERR_FILE_NOT_FOUND" in said
    assert tab.run("document.scrollingElement.scrollWidth") > 800
    assert tab.run(WIDE) != []
