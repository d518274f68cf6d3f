"""`python -m studies NAME [flags]`: finds the study in this folder and runs it; `reproduce cubes` is a name of two
words."""

import ast
import difflib
import importlib
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from deformscope.cli import guarded, with_flags
from deformscope.errors import InputError
from studies.runner import Study, run


def main(args: Sequence[str] | None = None) -> int:
    """Run one command line, as `deformscope.cli.main` does."""
    return guarded(_dispatch, list(sys.argv[1:] if args is None else args))


@cache
def summaries() -> dict[str, str]:
    """The first sentence of each study's file, by the study's name. None is imported for it."""
    found, folder = {}, Path(__file__).parent
    for path in sorted(folder.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        targets = [target for one in tree.body if isinstance(one, ast.Assign) for target in one.targets]
        if any(isinstance(one, ast.Name) and one.id == "STUDY" for one in targets):
            said = (ast.get_docstring(tree) or "").split("\n\n")[0]
            name = " ".join(path.relative_to(folder).with_suffix("").parts)
            found[name] = " ".join(said.split()).partition(": ")[2].rstrip(".")
    return found


def _dispatch(args: list[str]) -> int:
    known = summaries()
    if not args or args[0] in ("-h", "--help") or args in (["reproduce"], ["reproduce", "--help"]):
        print("usage: python -m studies NAME [flags]\n")
        shown = {name: said for name, said in known.items() if name.startswith("reproduce") or "reproduce" not in args}
        print("\n".join(f"  {name:<20} {said}" for name, said in shown.items()))
        print("\npython -m studies NAME --help   its flags")
        return 0
    words = 2 if args[0] == "reproduce" else 1
    name, rest = " ".join(args[:words]), args[words:]
    if name not in known:
        nearest = next(iter(difflib.get_close_matches(name, known, n=1)), "--help")
        raise InputError(f"a study out of {', '.join(known)}", repr(name), f"python -m studies {nearest}")
    study: Study = importlib.import_module(f"studies.{name.replace(' ', '.')}").STUDY
    return with_flags(study.options, lambda options: run(study, options), rest, f"python -m studies {name}")


if __name__ == "__main__":
    sys.exit(main())
