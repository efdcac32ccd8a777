"""Options are declared once: the signature of `outlast.train` is written from them, and places are counted.

python -m tests.options           list each option with the places where it is said what it is
python -m tests.options --write   write the signature anew, after an option was changed or added
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
DECLARED, SIGNATURE = ROOT / "training/base/config.py", ROOT / "training/runs/train.py"
COMMAND = ROOT / "training/cli/train.py"
CLASSES = ("RunOptions", "TrainingConfig")
BLOCK = re.compile(r"(?<=# <options>\n)(.*?)(?=    # </options>)", re.DOTALL)


def declared() -> Iterator[tuple[str, ast.AnnAssign]]:
    """The class and the field of each option, whose value is a call of option()."""
    for kind in ast.parse(DECLARED.read_text()).body:
        if isinstance(kind, ast.ClassDef) and kind.name in CLASSES:
            fields = (each for each in kind.body if isinstance(each, ast.AnnAssign))
            yield from ((kind.name, each) for each in fields if isinstance(each.value, ast.Call))


def _given(field: ast.AnnAssign, keyword: str) -> str:
    """A text that is given to option() by keyword; "" if it is not."""
    assert isinstance(field.value, ast.Call)
    return next((ast.literal_eval(each.value) for each in field.value.keywords if each.arg == keyword), "")


def parameters() -> str:
    """The lines of the signature: first the folder, which may be given without its name."""
    source, lines = DECLARED.read_text(), []
    for _, each in sorted(declared(), key=lambda found: CLASSES.index(found[0])):
        assert isinstance(each.value, ast.Call)
        name, usual = ast.unparse(each.target), ast.get_source_segment(source, each.value.args[0])
        lines.append(f"    {name}: {_given(each, 'takes') or f'{ast.unparse(each.annotation)} = {usual}'},\n")
    return "".join([lines[0], "    *,\n", *lines[1:]])


def written() -> str:
    """The source of the signature's file, as it has to be."""
    return BLOCK.sub(lambda found: parameters(), SIGNATURE.read_text())


def places() -> dict[str, list[str]]:
    """By option, the places where somebody has written what it is: declarations, flags, and Args of `train`."""
    found, flags = dict[str, list[str]](), dict[str, str]()
    for kind, each in declared():
        name = ast.unparse(each.target)
        found[name] = [f"{DECLARED.relative_to(ROOT)}:{each.lineno} ({kind})"]
        flags[_given(each, "flag") or f"--{name.replace('_', '-')}"] = name
    command, (_, call_of) = COMMAND.read_text(), BLOCK.sub("", SIGNATURE.read_text()).split("def train(")
    written = [(flags.get(flag, ""), "flag") for flag in re.findall(r'add_argument\(\s*"(--[\w-]+)"', command)]
    written += [(name, "Args") for name in re.findall(r"^        (\w+): [A-Z]", call_of, re.MULTILINE)]
    for name, what in written:
        found.get(name, []).append(f"{(COMMAND if what == 'flag' else SIGNATURE).relative_to(ROOT)} ({what})")
    return found


def main() -> int:
    """List, or write; the exit status is 1 if an option has two places or the signature is not as it has to be."""
    if "--write" in sys.argv[1:]:
        SIGNATURE.write_text(written())
    found, stale = places(), written() != SIGNATURE.read_text()
    for name, where in found.items():
        print(f"{name:12} {len(where)}  {', '.join(where)}")
    if stale:
        print("the signature of outlast.train differs from these: run `python -m tests.options --write`")
    return int(stale or any(len(where) > 1 for where in found.values()))


if __name__ == "__main__":
    sys.exit(main())
