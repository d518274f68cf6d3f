"""The linter of words: private words and their replacements, sentences, their length, and the texts that it reads."""

from pathlib import Path

import pytest

from tools import words

MODULE = '''
"""A module told beforehand."""

class Map:
    """Of the surface.

    size_m: its sides; told: how it was given
    """

    cell_m: float = 0.01
    """Side of a cell."""

def _own() -> None:
    """A private function, which nobody reads."""

def fit(name: str) -> None:
    """Fits `kept` values. Raises ValueError for a name without values."""
    raise ValueError(f"a name that the file knows; got {name!r}")
'''
PAGE = """# The title
A paragraph of one sentence that
goes on. Another with `told` in code.

- an item
| a cell | another |

```bash
deformscope told
```
"""


@pytest.mark.parametrize(
    ("sentence", "found"),
    [
        ("A flat surface by itself is all bending and hardly feels beta.", ["by itself", "feels"]),
        ("The force on the tip stands for the load.", []),
        ("The arm stands at the container, kept by somebody.", ["stands", "kept", "somebody"]),
        ("A second with a poke beside an earlier one meets the same.", ["beside", "meets the same"]),
        ("It reports what it meets, as it is.", ["what it meets", "as it is"]),
        ("kept: whether an existing file stays", []),
        ("The option --told and the key `beside` have names.", []),
        ("A stand with a stick has a scale.", []),
        ("Press where you want to know the force.", ["know"]),
        ("State the noise if you know it.", []),
    ],
)
def test_private_words_are_found(sentence: str, found: list[str]) -> None:
    assert sorted(hit.split("'")[1] for hit in words.private(sentence)) == sorted(found)


def test_every_private_word_has_a_replacement() -> None:
    (hit,) = words.private("Measured anew.")
    assert hit == "'anew': write again"
    assert all(words.PRIVATE.values())


@pytest.mark.parametrize(
    ("sentence", "headless"),
    [
        ("Of the surface.", True),
        ("As `Recorder.write`.", True),
        ("weight: (n,) of each", True),
        ("shift: as of `SeenSurface.shift`", True),
        ("weight: (n,) weight of each", False),
        ("The rate as of now.", False),
    ],
)
def test_docstrings_begin_with_a_noun(sentence: str, headless: bool) -> None:
    docstring, page = (words.Text(Path("a"), 1, kind, sentence) for kind in ("docstring", "document"))
    assert bool(words.headless(docstring, sentence)) == headless
    assert words.headless(page, sentence) == []


def test_sentences_end_at_stops_items_and_bars() -> None:
    assert words.sentences("One sentence [m]. Another e.g. with eq. 3.7 in it (see below). `code` begins one.") == [
        "One sentence [m].",
        "Another e.g. with eq. 3.7 in it (see below).",
        "`code` begins one.",
    ]
    assert words.sentences("expected a file; got none | try: another | a.npz") == [
        "expected a file; got none",
        "try: another",
        "a.npz",
    ]
    assert words.sentences("Of a map.\n\n    size_m: its sides; cell_m: the side\n    of a cell") == [
        "Of a map.",
        "size_m: its sides",
        "cell_m: the side of a cell",
    ]
    assert words.sentences("Fit a pair:\n\n    deformscope calibrate beta pair.npz") == ["Fit a pair:"]


def test_units_shapes_and_code_are_not_words() -> None:
    assert words.words("The force (n, 3) on the tip [N], as `fit(a, b)` gives it - see [the page](a/b.md).") == 12


def test_a_modules_public_texts_are_read(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(MODULE, encoding="utf-8")
    found = [(text.line, text.kind, " ".join(text.text.split())) for text in words.texts(path)]
    assert found == [
        (2, "docstring", "A module told beforehand."),
        (5, "docstring", "Of the surface. size_m: its sides; told: how it was given"),
        (11, "docstring", "Side of a cell."),
        (17, "docstring", "Fits `kept` values. Raises ValueError for a name without values."),
        (18, "message", "a name that the file knows; got {}"),
    ]


def test_a_pages_prose_is_read_without_code(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(PAGE, encoding="utf-8")
    found = [sentence for text in words.texts(path) for sentence in words.sentences(text.text)]
    assert found == [
        "The title A paragraph of one sentence that goes on.",
        "Another with `told` in code.",
        "an item",
        "a cell",
        "another",
    ]
    assert not any(words.private(sentence) for sentence in found)


def test_the_command_fails_for_words_and_for_many_long_sentences(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(words, "ROOT", tmp_path)
    page = tmp_path / "page.md"

    def status(text: str, *flags: str) -> int:
        page.write_text(text, encoding="utf-8")
        monkeypatch.setattr("sys.argv", ["words.py", str(page), *flags])
        return words.main()

    assert status("A rather short sentence. " * 30) == 0
    assert status("It is told.") == 1
    assert "page.md:1: 'told': write given" in capsys.readouterr().out
    long = "Words " + "word " * words.MOST_WORDS + "end. "
    assert status("A rather short sentence. " * 30 + long) == 0
    assert status("A rather short sentence. " * 3 + long, "--long") == 1
    assert f"page.md:1: {words.MOST_WORDS + 2} words: Words word" in capsys.readouterr().out
