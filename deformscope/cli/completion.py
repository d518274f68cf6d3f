"""`deformscope completion`: the words that a shell completes, for bash, zsh and fish.

eval "$(deformscope completion bash)" deformscope completion fish > ~/.config/fish/completions/deformscope.fish

tyro's own script completes flags and their choices, but no positional values such as `sample:tension` and `lab:bench`.
"""

import dataclasses
import shlex
from collections.abc import Iterable, Iterator
from typing import Any, get_args, get_origin, get_type_hints

from tyro.conf import Positional

from deformscope import cli, config
from deformscope.config import CompletionConfig
from deformscope.config.options import Flags, flags_of, marks_of

SCRIPTS = {
    "bash": """_deformscope() {
    local IFS=$'\\n'
    COMPREPLY=($(deformscope completion bash --line "${COMP_LINE:0:COMP_POINT}" 2>/dev/null))
}
complete -o default -F _deformscope deformscope
""",
    "zsh": """(( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }
_deformscope() {
    local -a found
    found=("${(@f)$(deformscope completion zsh --line "${(j: :)words[1,CURRENT]}" 2>/dev/null)}")
    if [[ -n "$found" ]]; then compadd -Q -- $found; else _files; fi
}
compdef _deformscope deformscope
""",
    "fish": """function __deformscope
    set -l found (deformscope completion fish --line (commandline -cp | string collect) 2>/dev/null)
    set -q found[1]; and printf '%s\\n' $found
    or __fish_complete_path (commandline -ct)
end
complete -c deformscope -f -a '(__deformscope)'
""",
}


def run(options: CompletionConfig) -> None:
    """Print the shell's script, or the possible next words of a line."""
    if options.line is None:
        print(SCRIPTS[options.shell], end="")
        return
    begun = options.line.rpartition(" ")[2]
    shown = len(begun.rpartition(":")[0]) + 1 if options.shell == "bash" and ":" in begun else 0
    for word in next_words(options.line):
        print(word[shown:])  # bash takes what follows a colon for a word of its own


def next_words(line: str) -> list[str]:
    """The words that may replace a line's last word, which may be empty."""
    before, _, begun = line.rpartition(" ")
    try:
        typed = shlex.split(before)[1:]
    except ValueError:  # within quotation marks
        return []
    return sorted(word for word in set(_candidates(typed, begun)) if word.startswith(begun))


def _candidates(typed: list[str], begun: str) -> Iterable[str]:
    name = next((name for name in (" ".join(typed[:2]), " ".join(typed[:1])) if name in cli.COMMANDS), "")
    group = [one.split()[-1] for one in cli.COMMANDS if len(typed) == 1 and one.startswith(f"{typed[0]} ")]
    if not name:
        return group if typed else [one.split()[0] for one in cli.COMMANDS]
    flags = dict(_flags(getattr(config, cli.COMMANDS[name].config)))
    if typed[-1] in flags:
        return flags[typed[-1]]
    return [*group, *(flags if begun.startswith("-") else flags.get("", ()))]


def _flags(kind: type) -> Iterator[tuple[str, list[str]]]:
    """The flags of a command, each with its possible values; under the empty name those of its sources."""
    hints, named = get_type_hints(kind), flags_of(kind)
    for field in dataclasses.fields(kind):
        hint: Any = hints[field.name]
        if isinstance(hint, type) and issubclass(hint, Flags):
            yield from _flags(hint)
            continue
        kinds = (hint, *get_args(hint))
        values = [str(value) for one in kinds if "Literal" in str(get_origin(one)) for value in get_args(one)]
        marks = marks_of(kind)[field.name]
        if Positional in marks:
            yield "", values or _sources(next(filter(None, (getattr(one, "metavar", None) for one in marks)), ""))
        else:
            yield named[field.name], values


def _sources(called: str) -> list[str]:
    """Simulated scenes and rigs, or samples. called: the positional argument in the help"""
    from deformscope.file_io import SAMPLE_SCHEME, sample_names

    if not called.startswith("RIG"):
        return [f"{SAMPLE_SCHEME}{one}" for one in sample_names()]
    from deformscope.lab.scenes import BUILT_IN, BURIED
    from deformscope.rig.rig_file import LAB_SCHEME, scenario_names

    return [f"{LAB_SCHEME}{one}" for one in (*BUILT_IN, *BURIED, *scenario_names())]
