"""No sentence of the guides is longer than a reader takes in at once; `docs/evidence/` is not counted."""

import re
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parent.parent
GUIDES = sorted(page for folder in (".", "tutorials") for page in (ROOT / "docs" / folder).glob("*.md"))
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *GUIDES,
]
LONGEST = 40  # words

FENCE = re.compile(r"\s*(```|~~~)")
ITEM = re.compile(r"\s*(?:[-*+]|\d+\.)\s+")
RULE = re.compile(r"[\s|:-]+")  # below the head of a table
END = re.compile(r"(?<=[.!?])[)\"'*_]*(?=\s+[^\sa-z])|[.!?:][)\"'*_]*$")  # `e.g. this` and `0.5` do not end
WORD = re.compile(r"[^\W_]")
NAMES = re.compile(r"(?:`code`,\s+){9,}`code`")  # a list that is looked up, not read


class Sentence(NamedTuple):
    """A sentence and the line of its page where it begins, from 1."""

    line: int
    text: str

    @property
    def words(self):
        return sum(1 for word in self.text.split() if WORD.search(word))


def plain(line):
    """Text as a reader sees it: code is one word, a link its text, an image nothing."""
    line = re.sub(r"`+[^`]+`+", "`code`", line)
    line = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", line)
    line = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", line)
    return re.sub(r"<[^>]+>|https?://\S+", "", line)


def blocks(text):
    """Paragraphs, list items and cells of tables: lists of (number of the line, text of the line)."""
    block, fence = [], False
    for number, line in enumerate(text.splitlines(), 1):
        opens = FENCE.match(line)
        fence = fence != bool(opens)
        item = ITEM.match(line)
        table = line.lstrip().startswith("|")
        apart = bool(fence or opens or table or line.startswith("#") or not line.strip())
        if (apart or item) and block:
            yield block
            block = []
        if table and not fence and not RULE.fullmatch(line):
            yield from ([(number, cell)] for cell in re.split(r"(?<!\\)\|", plain(line)) if cell.strip())
        elif not apart:
            block.append((number, line[item.end() :] if item else line))
    if block:
        yield block


def sentences(text):
    """Sentences of a page; a colon ends one at the end of its block."""
    for block in blocks(text):
        # Code and links may go over the end of a line: a mark keeps the lines apart meanwhile.
        marked = plain("".join(f"\x02{number}\x03{line.strip()} " for number, line in block)).strip()
        line, start = block[0][0], 0
        shown = re.sub(r"\x02\d+\x03", lambda mark: " " * len(mark.group()), marked)
        for end in [*(match.end() for match in END.finditer(shown)), len(shown)]:
            if not (words := NAMES.sub("`code`", " ".join(shown[start:end].split()))):
                continue
            first = start + len(shown[start:]) - len(shown[start:].lstrip())
            passed = re.findall(r"\x02(\d+)\x03", marked[:first])
            yield Sentence(int(passed[-1]) if passed else line, words)
            start = end


def too_long(page):
    """What is to be split, a line each."""
    return [
        f"{page.relative_to(ROOT)}:{sentence.line}: {sentence.words} words: {sentence.text[:70].strip()}"
        for sentence in sentences(page.read_text(encoding="utf-8"))
        if sentence.words > LONGEST
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_sentence_is_too_long(page):
    found = too_long(page)
    assert not found, "\n" + "\n".join(found)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("One. Two! Three? Four", [(1, "One."), (1, "Two!"), (1, "Three?"), (1, "Four")]),
        ("One goes\non here. Two\nends.", [(1, "One goes on here."), (2, "Two ends.")]),
        ("One.\n\nTwo.", [(1, "One."), (3, "Two.")]),
        ("Each case:\n- one\n- two\n  goes on", [(1, "Each case:"), (2, "one"), (3, "two goes on")]),
        ("A colon: it goes on.", [(1, "A colon: it goes on.")]),
        ("Wait 0.5 s, i.e. not long.", [(1, "Wait 0.5 s, i.e. not long.")]),
        ("# A heading\nText.", [(2, "Text.")]),
        ("Before.\n```yaml\nnet: a. B\n```\nAfter.", [(1, "Before."), (5, "After.")]),
        ("| key | |\n|---|---|\n| a | One. Two |", [(1, "key"), (3, "a"), (3, "One."), (3, "Two")]),
        ("See [the page](a.md#b), `x. Y` and\n`a\nb`.", [(1, "See the page, `code` and `code`.")]),
        ("Wheels: " + ", ".join(["`a`"] * 50) + ".", [(1, "Wheels: `code`.")]),
        ("(One.) Two.", [(1, "(One.)"), (1, "Two.")]),
    ],
)
def test_the_parser_of_sentences(text, expected):
    assert [(sentence.line, sentence.text) for sentence in sentences(text)] == expected


def test_a_sentence_of_forty_words_is_the_longest():
    assert Sentence(1, "word " * 40).words == LONGEST
    assert Sentence(1, "a - b / c, code: d").words == 5


def test_what_is_found_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("Short.\n\n" + "word " * 41)
    assert too_long(page) == [f"page.md:3: 41 words: {('word ' * 14).strip()}"]
    page.write_text("word " * 40)
    assert not too_long(page)
