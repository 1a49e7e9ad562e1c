"""Parses the pages for their tests: examples, tables, links and commands of each Markdown file.

A mark is an HTML comment on the line before an example or a table. Fenced blocks are examples:

    ```sh, ```python    run, in order, in one folder for the page; Python blocks of a page share their variables
    ```yaml             fields of an arm's file: they replace those of a small arm, which is then read
    ```json             must be JSON
    ```text             is not tested

    <!-- not run: WHY -->        commands and options of the block are compared with the code, and nothing runs
    <!-- with: daemon -->        while the block runs, a daemon with the simulated boards of planar16 is ready
    <!-- with: daemon of FILE -->        one of an arm's file that the page has written
    <!-- request: KEY -->        the JSON is sent to such a daemon on hyperbit/planar16/KEY, which has to accept it
    <!-- prints -->              each line of the text is a line that the example before prints; `...` is any text
    <!-- table: NAME -->         the names in the first column are those that `facts.TABLES[NAME]` has
    <!-- table: NAME, column 2 -->   those of the second column; several tables of one name are one table

In a table "fields of S" a column headed "example" has fields in backticks, as in `inrush: 4`, that suit the struct S.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
LANGUAGES = ("sh", "python", "yaml", "json", "text")
MARK = re.compile(r"^<!-- (not run|with|request|prints|table)(?:: (.*?))? -->$")


class Example(NamedTuple):
    """One fenced block."""

    line: int
    language: str
    text: str
    marks: dict[str, str]


class Table(NamedTuple):
    """One marked table.

    Attributes:
        names: in backticks in the column of the mark.
        examples: in backticks in the column that is headed "example".
    """

    line: int
    name: str
    names: list[str]
    examples: list[str]


class Page(NamedTuple):
    """One page.

    Attributes:
        prose: its lines outside of fenced blocks.
    """

    path: Path
    text: str
    prose: str
    examples: list[Example]
    tables: list[Table]

    @property
    def name(self) -> str:
        """Path relative to the project, for messages."""
        return self.path.relative_to(ROOT).as_posix()


def find() -> list[Path]:
    """Returns the paths of all pages, except in `build`, whose files may change during a test."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and not re.match(r"\.|build$", path.name)]
    return sorted([*ROOT.glob("*.md"), *(path for folder in folders for path in folder.rglob("*.md"))])


def read(path: Path) -> Page:
    text = path.read_text()
    lines, examples, tables, prose = text.splitlines(), list[Example](), list[Table](), list[str]()
    marks: dict[str, str] = {}
    k = 0
    while k < len(lines):
        line, where = lines[k], f"{path.relative_to(ROOT)}:{k + 1}"
        k += 1
        if found := MARK.match(line):
            marks[found[1]] = found[2] or ""
        elif line.startswith("```"):
            language, begin = line[3:], k
            if language not in LANGUAGES:
                raise ValueError(f"{where}: the block is {language!r}, none of {LANGUAGES}")
            while k < len(lines) and lines[k] != "```":
                k += 1
            examples.append(Example(begin, language, "\n".join(lines[begin:k]) + "\n", marks))
            k, marks = k + 1, {}
        elif line.startswith("|") and "table" in marks:
            begin = k
            while k < len(lines) and lines[k].startswith("|"):
                k += 1
            name, _, column = marks["table"].partition(", column ")
            rows, headings = lines[begin + 1 : k], [cell.strip() for cell in lines[begin - 1].split("|")]
            given = named(rows, headings.index("example")) if "example" in headings else []
            tables.append(Table(begin, name, named(rows, int(column or 1)), given))
            prose += lines[begin - 1 : k]
            marks = {}
        elif marks and line:
            raise ValueError(f"{where}: a mark precedes neither a block nor a table: {marks}")
        else:
            prose.append(line)
    return Page(path, text, "\n".join(prose), examples, tables)


def named(rows: list[str], column: int) -> list[str]:
    cells = [re.split(r"(?<!\\)\|", row)[column] for row in rows]
    return [name for cell in cells for name in re.findall(r"`([^`]+)`", cell)]


def links(page: Page) -> list[str]:
    """Returns the targets of links and pictures that are relative."""
    found = re.findall(r"\]\(([^)\s]+)\)", page.prose)
    return [target for target in found if not re.match(r"[a-z]+:", target)]


def code(page: Page) -> list[str]:
    """Returns the texts in backticks, and the lines of shell blocks."""
    inline = re.findall(r"`([^`\n]+)`", page.prose)
    return inline + [
        line for example in page.examples if example.language == "sh" for line in example.text.splitlines()
    ]


def commands(page: Page) -> list[str]:
    """Returns the calls of `hyperbit` on a page, each from its command's name on."""
    call = re.compile(r"(?:^|sudo |\| |&& |; |\$\()(?:[A-Z_]+=\S+ )*(?:\.venv/bin/)?hyperbit +(-?[a-z][^|;&#)]*)")
    return [found[1].strip() for line in code(page) for found in call.finditer(line.strip())]


def modules(page: Page) -> list[str]:
    found = [name for line in code(page) for name in re.findall(r"python3? -m ([\w.]+)", line)]
    return [name for name in found if name.islower()]  # NAME stands for any


def targets(page: Page) -> list[str]:
    return [found[1] for line in code(page) if (found := re.match(r" *make ([a-z0-9-]+)", line))]


def headings(page: Page) -> set[str]:
    """Returns the anchors of a page's headings, as GitHub makes them."""
    found = re.findall(r"^#+ (.*)$", page.prose, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in found}


def paths(page: Page) -> list[str]:
    rooms = re.compile(r"^(?:controller|drivers|tests|deploy)/[\w./*@-]*$")
    return [text for text in re.findall(r"`([^`\n]+)`", page.prose) if rooms.match(text)]
