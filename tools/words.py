"""Checks the English of documents, messages, help texts and docstrings: words, and the length of sentences.

python tools/words.py [PATH...] [--draw N --seed S]

A word of `PRIVATE` is reported with what to write instead. Of each tree at most 5 % of the sentences may have more
than 25 words. `--draw` prints sentences at random, for a reader.
"""

import argparse
import ast
import random
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TREES = ("deformscope", "drivers", "studies", "docs", "README.md", "CONTRIBUTING.md", "recordings/README.md")
MOST_WORDS, MOST_LONG = 25, 0.05
LEAST_WORDS = 4
"""Shorter texts are no sentences: their words are checked, and they do not lower the share of long ones."""
PRIVATE = {
    r"told": "given, stated, known, distinguished",
    r"beside": "next to, with, besides",
    r"by (?:it|them)sel(?:f|ves)": "alone, automatically",
    r"stands?(?! for\b)": "is, are, is written",
    r"kept(?!:)": "stored, held, unchanged, left",
    r"had it|that is none|that are none": "say who does what",
    r"feels?|felt": "measures, is loaded",
    r"hears?|heard": "receives",
    r"(?<!you )(?:knows?|knew)": "has, is given, identifies",
    r"what it knows|meets? the same|as it comes|made of it": "say who does what",
    r"sa(?:ys?|id) (?:so|of|nothing|most|more|less|enough)": "states, shows, reports",
    r"tells?": "reports, shows, determines",
    r"anew": "again",
    r"takes? (?:it|them|this|one) for|taken for|takes for": "classified as, mistaken for",
    r"makes? of": "computes from",
    r"believe[sd]?": "estimated, assumed",
    r"(?<!you )wants?|wanted": "needs, requests",
    r"put right|beforehand": "corrected; before, prior",
    r"somebody|someone|nobody": "a person, an operator, no person",
    r"(?:came|comes?|become) of": "outcome, result",
    r"keeps? nothing|lets? go\b(?! of)": "say who does what; release",
    r"(?:from|since) (?:which|where) on": "from",
    r"(?:what|than|as) (?:it|they) (?:was|were|is|are|has|had|does|did)(?=[.,;:)]|$)": "name it",
    r"what (?:it|they|he|one) (?:meets|met|feels|says|said|gave|gives|knows|found|sees|saw|does|did)": "name it",
}
"""Patterns of whole words, and what to write instead."""
HEADLESS = re.compile(
    r"(\w+(, \w+)*( \([^()]*\))?: (\([^()]*\),? |\[[^\]]*\],? )*)?[Oo]f\b(?!:)|As `|.*\bas of (?!now)"
)
"""Beginnings of docstrings, and of what they have about a field, that lack their noun."""
EXCEPT = "|".join(
    (
        r"(?:A|a|simulated) stand\b",
        r"exact and told$|^told JSON|told, truth",
        r"\(\w, kept\)|^NOT kept",
        r"\[calibrated\.time\] device and beside|beside `label`",
        r"if its flags say so|the library (?:does not know|cannot say)",
        r"\(\"want\",|that is None|kind: stands",
    )
)
"""Names of keys, columns and rows; a stand is a thing."""
COMMANDS = ("deformscope ", "python ", "make ")
"""Beginnings of lines to type."""
CODE = re.compile(r"[;{]\n|\(\?|\\[wdsb]|;\s*\+\+|\.data\[|<\w+ \w+=")
"""Found in strings that are programs or regular expressions."""


@dataclass(frozen=True, slots=True)
class Text:
    """A text that a user or developer reads: where it is, its kind (document, message, help, docstring), its words."""

    path: Path
    line: int
    kind: str
    text: str

    def __str__(self) -> str:
        return f"{self.path.relative_to(ROOT)}:{self.line}"


def _markdown(path: Path) -> Iterator[Text]:
    """Paragraphs, list items and cells of a page, without code, links' addresses and HTML."""
    page = path.read_text(encoding="utf-8")
    for pattern in (r"^```.*?^```$", r"<!--.*?-->", r"^---\n.*?^---$"):
        page = re.sub(pattern, lambda found: "\n" * found[0].count("\n"), page, flags=re.DOTALL | re.MULTILINE)
    start, block = 1, list[str]()
    for number, line in enumerate([*page.splitlines(), ""], 1):
        cell = line.lstrip().startswith("|")
        if not line.strip() or cell or re.match(r"\s*([-*+#]|\d+\.|!!!|\?\?\?)\s*", line):
            yield Text(path, start, "document", "\n".join(block))
            start, block = number, []
        if cell:
            yield from (Text(path, number, "document", part) for part in re.split(r"(?<!\\)\|", line))
        else:
            block.append(re.sub(r"^\s*([-*+#>]+|\d+\.|!!!\s*\w*|\?\?\?\s*\w*)\s+", "", line))


def _string(node: ast.expr) -> str | None:
    """A string as written, a value of an f-string being `{}`; None of anything else."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(_string(part) or "{}" for part in node.values)
    return None


def _module(path: Path) -> Iterator[Text]:
    """Docstrings of public names and of attributes, and strings of several words."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    parts: set[ast.AST] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts.update(node.values)
        for statement in getattr(node, "body", None) or () if not isinstance(node, ast.Lambda | ast.IfExp) else ():
            if isinstance(statement, ast.Expr) and (text := _string(statement.value)):
                parts.add(statement.value)
                public = statement is not node.body[0] or not getattr(node, "name", "").startswith("_")
                kind = "help" if "config" in path.parts else "docstring"
                yield from [Text(path, statement.lineno, kind, text)] if public else ()
    for node in ast.walk(tree):
        text = _string(node) if isinstance(node, ast.expr) and node not in parts else None
        if text and " " in text and re.search(r"\b[a-z]+\b", text) and not CODE.search(text):
            yield Text(path, node.lineno, "message", text)


def texts(path: Path) -> Iterator[Text]:
    """The texts of a file or of all files in a folder."""
    if path.is_dir():
        for found in sorted([*path.rglob("*.md"), *path.rglob("*.py")]):
            yield from texts(found)
    else:
        yield from _markdown(path) if path.suffix == ".md" else _module(path)


def sentences(text: str) -> list[str]:
    """The sentences of a text: they end at a full stop, at an empty line, and at the bars of a message."""
    item = r"(?=\w+(?:, \w+)*(?: \([^()]*\))?: )"
    full_stop = r"(?<=[.!?])(?<!eq\.)(?<!fig\.)(?<!ch\.)(?<!al\.)(?<!e\.g\.)[\")*_]*\s+(?=[\"'(*_`\[A-Z0-9]|--|\w+:)"
    found = re.split(rf"{full_stop}|\n\s*\n|\s\|\s|\n\s*(?=[-*] )|;\s+{item}|\n\s*{item}|\n(?=[^\n]*\S  +\S)", text)
    flat = (" ".join(part.split()) for part in found if part)
    return [part for part in flat if part and not part.startswith(COMMANDS)]


def words(sentence: str) -> int:
    """How many words a sentence has; code is one, units and shapes are none."""
    sentence = re.sub(r"\]\([^)]*\)", "]", sentence)
    sentence = re.sub(r"`[^`]*`", "code", re.sub(r"\[[^\]\s]{1,12}\]|\(\w*,[^)]*\)", "", sentence))
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


def private(sentence: str) -> list[str]:
    """The private words of a sentence, each with what to write instead."""
    prose = re.sub(rf"{EXCEPT}|^\w+(?:, \w+)*: |`[^`]*`|\]\([^)]*\)|--\w\S*", "", sentence)
    found = (
        (hit[0], instead)
        for word, instead in PRIVATE.items()
        for hit in re.finditer(_whole(word), prose, re.IGNORECASE)
    )
    return [f"{hit!r}: write {instead}" for hit, instead in found]


def headless(at: Text, sentence: str) -> list[str]:
    """A sentence of a docstring that begins with "Of" or "As `", or refers with "as of"."""
    found = at.kind in ("docstring", "help") and HEADLESS.match(sentence)
    return [f"{found[0]!r}: write the noun that it is of, 'See `X`', or 'as in'"] if found else []


def _whole(word: str) -> str:
    return rf"(?<![\w./-])(?:{word})(?![\w/=-])"


def main() -> int:
    """Prints private words and the share of long sentences of each tree; 1 if there are any, or too many."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("paths", nargs="*", type=Path, default=[ROOT / tree for tree in TREES])
    parser.add_argument("--draw", type=int, default=0, metavar="N", help="print sentences at random, and check nothing")
    parser.add_argument("--seed", type=int, default=37, help="of --draw")
    parser.add_argument("--long", action="store_true", help="list long sentences as well")
    options = parser.parse_args()
    trees = {
        tree: [(at, line) for at in texts(tree.resolve()) for line in sentences(at.text)] for tree in options.paths
    }
    if options.draw:
        drawn = [f"{at}: {line}" for found in trees.values() for at, line in found if at.kind != "document"]
        print(*random.Random(options.seed).sample(drawn, min(options.draw, len(drawn))), sep="\n")
        return 0
    failed = False
    for tree, found in trees.items():
        long = [f"{at}: {words(line)} words: {line}" for at, line in found if words(line) > MOST_WORDS]
        hits = [f"{at}: {hit}" for at, line in found for hit in [*private(line), *headless(at, line)]]
        count = sum(words(line) >= LEAST_WORDS for _, line in found)
        share = len(long) / max(count, 1)
        for line in [*hits, *(long if options.long else ())]:
            print(line)
        print(f"{tree}: {count} sentences, {share:.1%} above {MOST_WORDS} words, {len(hits)} private words")
        failed |= bool(hits) or share > MOST_LONG
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
