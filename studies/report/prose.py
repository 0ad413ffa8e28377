"""Sections of a page, their words in a template beside the study that makes them.

The template (jinja2) has a macro for each section, of the values that its words are made with. An
empty line ends a paragraph, as does a line that begins with ``[``. How it begins says what it is:

- ``# `` the section's title,
- ``> `` its sentence for the top of the page,
- ``[figure NAME] ``, ``[alt NAME] ``, ``[table NAME] ``, ``[note NAME] `` what stands under a
  figure, what a figure is to who cannot see it, over a table and under it,
- ``| `` a comparison, its cells apart by `` | `` (`page.Comparison`),
- anything else: the section's text.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure as Drawing

from ...solver import paper
from .figures import picture, stiffness_label
from .page import (
    Comparison,
    Figure,
    Frame,
    Head,
    Section,
    Table,
    Verdict,
    environment,
    percent,
    show,
)


@dataclass
class Draft(Section):
    """A section with its words, to which figures and tables come.

    ``marked`` are the words that stand elsewhere than in the text, by their marks.
    """

    text: list[str] = field(default_factory=list)
    heads: Mapping[str, Head] = field(default_factory=dict)
    marked: dict[str, str] = field(default_factory=dict)

    def data(self, name: str, frame: Frame, heads: Mapping[str, Head] | None = None) -> Table:
        """The table of ``frame`` (`page.Table.of`) with its caption, for behind a figure.

        Its columns are headed as ``heads`` and those of all tables of the study say.
        """
        note = self.marked.get(f"note {name}", "")
        return Table.of(
            name, self.marked[f"table {name}"], frame, {**self.heads, **(heads or {})}, note
        )

    def table(self, name: str, frame: Frame, heads: Mapping[str, Head] | None = None) -> Table:
        """The same as a table of the section."""
        self.tables.append(self.data(name, frame, heads))
        return self.tables[-1]

    def figure(self, name: str, drawn: Drawing | None, data: Table) -> None:
        """A figure of the section, with the numbers that it shows; where there is nothing to draw,
        these alone as a table."""
        if drawn is None:
            self.tables.append(data)
            return
        caption, alt = (self.marked[f"{what} {name}"] for what in ("figure", "alt"))
        self.figures.append(Figure(name, caption, picture(drawn), alt, data))

    def section(self, command: str = "") -> Section:
        """All of it, and the ``command`` that makes it."""
        self.title, self.command = self.marked["#"], command
        self.headline = self.marked.get(">", "")
        return self


class Prose:
    """The template at ``path``, in which ``filters`` can be used beside those of all pages.

    ``heads`` are those of columns of the study's tables (`page.column`).
    """

    def __init__(
        self,
        path: Path,
        heads: Mapping[str, Head] | None = None,
        **filters: Callable[..., Any],
    ) -> None:
        self.path, self.heads, self.filters = path, heads or {}, FILTERS | filters

    def __call__(self, macro: str, ident: str = "", **values: Any) -> Draft:
        """The words of one macro for the section ``ident``, by default named as the macro.

        Raises TypeError where the macro does not take one of the ``values``, jinja2's
        UndefinedError where it wants another.
        """
        draft = Draft(ident or macro, "", heads=self.heads)
        for lines in re.split(r"\n\s*\n|\n(?=\[)", str(getattr(self._module, macro)(**values))):
            paragraph = re.sub(r"[ \n]+", " ", lines).strip()
            if found := re.fullmatch(r"([#>|]|\[\w+ [\w-]+\]) (.+)", paragraph):
                mark, words = found[1].strip("[]"), found[2]
                if mark == "|":
                    draft.comparisons.append(_comparison(f"{words} ".split(" | ")))
                else:
                    draft.marked[mark] = words
            elif paragraph:
                draft.text.append(paragraph)
        return draft

    def text(self, macro: str, **values: Any) -> list[str]:
        """The paragraphs of one macro."""
        return self(macro, **values).text

    @cached_property
    def _module(self) -> Any:
        """Its words are plain text: the page escapes them."""
        templates = environment(self.path.parent, self.filters)
        templates.globals["paper"] = paper
        return templates.get_template(self.path.name).module


def _comparison(cells: list[str]) -> Comparison:
    quantity, place, printed, one, three, difference, verdict, remark = map(str.strip, cells)
    return Comparison(quantity, place, printed, one, three, difference, Verdict(verdict), remark)


FILTERS: dict[str, Callable[..., Any]] = {
    "show": show,
    "percent": percent,
    "stiffness": stiffness_label,
    "verdict": Verdict.of,
    "g": lambda value, digits="": format(value, f".{digits}g" if digits else "g"),
    "f": lambda value, decimals: f"{value:.{decimals}f}",
}
