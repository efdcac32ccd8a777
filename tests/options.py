"""Options are declared once; signatures and docstrings of functions that share them are written from one place.

Those of training are fields of dataclasses, those of environments arguments of `outlast.make_vec`.

python -m tests.options           list each option with the place where it is declared
python -m tests.options --write   write signatures and docstrings anew, after an option was changed or added
"""

import ast
import dataclasses
import itertools
import re
import sys
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from outlast import systems
from outlast.ecs import Module
from outlast.envs.api import check, film, play, rollout
from outlast.envs.api.options import default_of, options_of
from outlast.envs.rendering.layers import FILM_LAYERS_BY_NAME
from outlast.envs.rollout.policies import POLICIES
from outlast.training.base import config
from outlast.training.plots import plot
from outlast.training.runs import train  # noqa: F401  # which describes options of training

ROOT = Path(__file__).parents[1]
COLUMNS = 112  # of a docstring, behind its indent
TRAINING = ROOT / "training/base/config.py", (config.RunOptions, config.TrainingConfig)
MAKE = ROOT / "envs/api/make.py"
OWN = frozenset({"seed", "observations"})  # what adapters describe in their own way
ALL: frozenset[str] = frozenset()
# functions, where their options are declared, and what they say of them otherwise; a new option goes into the first two
FUNCTIONS = {
    (ROOT / "training/runs/train.py", "train"): (*TRAINING, ALL),
    (ROOT / "training/arena/evaluation.py", "evaluate"): (TRAINING[0], (config.EvaluationOptions,), ALL),
    (ROOT / "envs/adapters/gymnasium_agents.py", "make_agents"): (MAKE, (), OWN),
    (ROOT / "envs/adapters/sb3.py", "make_sb3"): (MAKE, (), OWN | {"render_mode"}),
    (ROOT / "envs/adapters/puffer.py", "make_puffer"): (MAKE, (), OWN),
    (ROOT / "envs/adapters/torchrl.py", "make_torchrl"): (MAKE, (), OWN | {"actions"}),
    (ROOT / "envs/adapters/pettingzoo.py", "parallel_env"): (MAKE, (), OWN | {"render_mode", "action_masks"}),
}
FLAGS = {  # of functions whose docstrings also are the help of commands
    ROOT / "envs/api/rollout.py": (rollout.RolloutOptions,),
    ROOT / "envs/api/film.py": (film.FilmOptions, film.Looks),
    ROOT / "envs/api/play.py": (play.PlayOptions, play.PageOptions),
    ROOT / "envs/api/check.py": (check.CheckOptions,),
    ROOT / "training/plots/plot.py": (plot.PlotOptions,),
}
STUB = ROOT / "envs/scenarios/known_numbers.pyi"
NUMBERS = {int: "float", float: "float", bool: "bool", str: "str"}  # integers may be floats: 1e3
WHOLE = ("train", "evaluate")
PARAMETER = r"^    {}: .*\n"
ENTRY = r"^        {}: .*\n(?:            .*\n)*"  # of an argument, in a docstring


def fields(path: Path, kind: Any) -> Iterator[tuple[str, ast.AnnAssign]]:
    """The options of a dataclass, as they are written in a file."""
    for found in ast.parse(path.read_text()).body:
        if isinstance(found, ast.ClassDef) and found.name == kind.__name__:
            for each in found.body:
                if isinstance(each, ast.AnnAssign) and ast.unparse(each.target) in options_of(kind):
                    yield ast.unparse(each.target), each


def parameters(path: Path, kind: Any) -> dict[str, str]:
    """The lines of a signature, by option."""
    source, found = path.read_text(), dict[str, str]()
    for name, each in fields(path, kind):
        assert isinstance(each.value, ast.Call)
        plain = ast.unparse(each.value.func) == "option"
        text = ast.get_source_segment(source, each.value.args[0]) if plain else repr(default_of(kind, name))
        usual = f"{ast.unparse(each.annotation)} = {text}"
        found[name] = f"    {name}: {options_of(kind)[name].takes or usual},\n"
    return found


def argument_of(kind: Any, name: str) -> str:
    """Return what a docstring says of an option, as a sentence."""
    own, usual = options_of(kind)[name], default_of(kind, name)
    text = f"whether to {own.text}" if isinstance(usual, bool) else own.text
    if own.takes.endswith("= None") and "default" not in text and isinstance(usual, int | str):
        text += f" (default {usual})"
    if any(str(each) not in text for each in own.choices):
        text += f": {' or '.join(map(str, own.choices))}"
    return f"{text[:1].upper()}{text[1:]}. {own.python}".strip()


def arguments(kind: Any) -> dict[str, str]:
    """The lines of Args, by option."""
    texts = {name: f"{name}: {argument_of(kind, name)}" for name in options_of(kind)}
    filled = {name: textwrap.fill(text, COLUMNS, subsequent_indent="    ") for name, text in texts.items()}
    return {name: textwrap.indent(text, "        ") + "\n" for name, text in filled.items()}


def replaced(text: str, entry: str, lines: dict[str, str]) -> str:
    """A text in which each entry has its lines; those that it lacks follow the last one. entry: Matches that of {}."""
    last = 0
    for name, line in lines.items():
        if found := re.search(entry.format(name), text, re.MULTILINE):
            text = text[: found.start()] + line + text[found.end() :]
            last = max(last, found.start() + len(line))
        else:
            text = text[:last] + line + text[last:]
            last += len(line)
    return text


def written(path: Path, function: str) -> str:
    """The source of a file, with the signature and the docstring that a function has to have."""
    declared, kinds, own = FUNCTIONS[path, function]
    source = path.read_text().splitlines(keepends=True)
    (found,) = (each for each in ast.parse("".join(source)).body if getattr(each, "name", "") == function)
    assert isinstance(found, ast.FunctionDef)
    told = found.body[0]
    parts = (0, found.lineno - 1, told.lineno - 1, told.end_lineno, None)
    before, head, docstring, after = ("".join(source[first:last]) for first, last in itertools.pairwise(parts))
    lines, texts = dict[str, str](), dict[str, str]()
    if declared == MAKE:  # whose docstring that of the function refers to
        known = re.findall(r"^    (\w+): (.* = .*,)\n", declared.read_text(), re.MULTILINE)
        lines = {name: f"    {name}: {rest}\n" for name, rest in known}
    for kind in kinds:
        lines |= parameters(declared, kind)
        texts |= arguments(kind)
    given = {each.arg for each in (*found.args.args, *found.args.kwonlyargs)} - own
    for lines_of in (lines, texts):
        for name in lines_of.keys() - given if function not in WHOLE else own:
            lines_of.pop(name, None)
    head = replaced(head, PARAMETER, lines)
    docstring = replaced(docstring, ENTRY, texts)
    return before + head + docstring + after


def numbers_stub() -> str:
    """The stub that lists the numbers of outlast's mechanics."""
    kinds = [each for name in systems.__all__ if isinstance(each := getattr(systems, name), type)]
    modules = [each for each in kinds if issubclass(each, Module)]
    found = {f"{kind.name}_{item.name}": item for kind in modules for item in dataclasses.fields(kind)}
    types = {name: NUMBERS.get(item.type, "Sequence[float]") for name, item in found.items()}
    types |= {f"n_{name.removesuffix('_count')}": "float" for name in found if name.endswith("_count")}
    lines = "".join(f"    {name}: {types[name]}\n" for name in sorted(types))
    imports = "from collections.abc import Sequence\nfrom typing import TypedDict\n"
    return f"{imports}\nclass Numbers(TypedDict, total=False):\n{lines}"


def places() -> dict[str, str]:
    """By option, with its class, the place where it is declared. A parser refuses to add a flag again."""
    declared = {**{path: kinds for path, kinds, _ in FUNCTIONS.values()}, **FLAGS}.items()
    return {
        f"{kind.__name__}.{name}": f"{path.relative_to(ROOT)}:{each.lineno}"
        for path, kinds in declared
        for kind in kinds
        for name, each in fields(path, kind)
    }


def main() -> int:
    """List, or write; the exit status is 1 if a function is not as it has to be."""
    stale = {path: function for path, function in FUNCTIONS if written(path, function) != path.read_text()}
    if (stub := numbers_stub()) != (STUB.read_text() if STUB.exists() else ""):
        stale[STUB] = STUB.name
    for kind in (kind for kinds in FLAGS.values() for kind in kinds):
        assert all(own.text for own in options_of(kind).values()), kind  # its function describes them
    for name in (*POLICIES, *FILM_LAYERS_BY_NAME):
        assert re.search(rf"\b{name}\b", film.film.__doc__ or ""), name
    for name, where in places().items():
        print(f"{name:28} {where}")
    if stale and "--write" in sys.argv[1:]:
        for path, function in stale.items():
            path.write_text(stub if path == STUB else written(path, function))
    elif stale:
        print(f"not as declared: {', '.join(stale.values())}; run `python -m tests.options --write`")
    return int(bool(stale) and "--write" not in sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
