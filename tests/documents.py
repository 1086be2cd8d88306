"""The project's Markdown: its files, fenced blocks, links, headings and command lines."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote

from tests.conftest import ROOT

PAGES = sorted(
    path
    for pattern in ("*.md", "*/*.md", "*/*/*.md", "*/*/*/*.md")
    for path in ROOT.glob(pattern)
    if not path.relative_to(ROOT).parts[0].startswith(".")
    and path.relative_to(ROOT).parts[0] not in ("runs", "weights", "build")  # not in git
)
READMES = [path for path in PAGES if path.name == "README.md"]


@dataclass(frozen=True)
class Block:
    """A fenced block: its page, its position among those of its language, and its text."""

    page: Path
    index: int
    language: str
    text: str

    @property
    def name(self) -> str:
        """Its name in test ids."""
        return f"{self.page.relative_to(ROOT)}:{self.language}:{self.index}"


@dataclass(frozen=True)
class Line:
    """A command line of a page, as words, and whether it is in a fenced block."""

    page: Path
    words: tuple[str, ...]
    fenced: bool = True

    @property
    def name(self) -> str:
        """Its name in test ids."""
        return f"{self.page.relative_to(ROOT)}: {' '.join(self.words)}"


def blocks(language: str, pages: list[Path] | None = None) -> list[Block]:
    """Return the fenced blocks of one language."""
    found = []
    for page in PAGES if pages is None else pages:
        texts = re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.M | re.S)
        found += [Block(page, index, language, text) for index, text in enumerate(texts)]
    return found


def fenced_lines() -> list[Line]:
    """Return the commands of all shell blocks, without comments."""
    lines = []
    for block in blocks("sh"):
        for text in block.text.replace("\\\n", " ").splitlines():
            words = shlex.split(text, comments=True)
            if words:
                lines.append(Line(block.page, tuple(words)))
    return lines


def inline_lines(first: str) -> list[Line]:
    """Return the commands between backticks, outside fenced blocks, whose first word is `first`."""
    found = []
    for page in PAGES:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
        for code in re.findall(r"`([^`]+)`", text):
            code = " ".join(code.replace("\\|", "|").split())
            if code.startswith(f"{first} "):
                found.append(Line(page, tuple(code.split()), fenced=False))
    return found


def links(page: Path) -> list[str]:
    """Return the targets of links and pictures, except web addresses."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    found = re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", text))
    return [unquote(target) for target in found if "://" not in target]


def anchors(page: Path) -> set[str]:
    """Return the fragments of a page's headings, as Markdown viewers derive them."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(), re.M)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.strip().replace(" ", "-") for heading in plain}


def prose_words(page: Path) -> int:
    """Return the number of words of a page, as `wc -w` counts them."""
    return len(page.read_text().split())
