"""Mutants of systems/: one small change each, made by cosmic-ray's operators.

Excluded, as no test could or should detect them:
* decorators: they have no effect on uncompiled kernels, and `@NAME.system` is tested in ecs;
* annotations, docstrings, and f-strings, which are messages here;
* all but one or two replacements of an operator: twelve would count the same line twelve times;
* -1 for the index 0: most columns indexed so have one entry;
* changes that Python does not compile.
"""

import difflib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from random import Random
from typing import Any

import cosmic_ray.plugins
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code

from tests.mutants.selection import ROOT

BINARY = "Add_Sub Sub_Add Mul_Div Div_Mul FloorDiv_Mul Mod_FloorDiv Pow_Mul RShift_LShift LShift_RShift "
BINARY += "BitOr_BitAnd BitAnd_BitOr BitXor_BitAnd"
COMPARISON = "Eq_NotEq NotEq_Eq Lt_LtE Lt_GtE LtE_Lt LtE_Gt Gt_GtE Gt_LtE GtE_Gt GtE_Lt Is_IsNot IsNot_Is"
UNARY = "Delete_USub Delete_Invert Delete_Not"
OTHERS = "NumberReplacer ReplaceTrueWithFalse ReplaceFalseWithTrue ReplaceAndWithOr ReplaceOrWithAnd AddNot "
OTHERS += "ReplaceBreakWithContinue ReplaceContinueWithBreak ZeroIterationForLoop ExceptionReplacer"
OPERATORS = (
    *(f"ReplaceBinaryOperator_{name}" for name in BINARY.split()),
    *(f"ReplaceComparisonOperator_{name}" for name in COMPARISON.split()),
    *(f"ReplaceUnaryOperator_{name}" for name in UNARY.split()),
    *OTHERS.split(),
)
UNTESTED = {"decorator", "fstring", "import_from", "import_name"}  # types of parso's nodes


@dataclass(frozen=True)
class Mutant:
    """A change to a file; `occurrence` counts the places where the operator could change it."""

    file: str  # as in "systems/give_last.py"
    operator: str
    occurrence: int
    line: int

    @property
    def source(self) -> str:
        """The whole file with the change."""
        return changed((ROOT / self.file).read_text(), self.operator, self.occurrence)

    @property
    def possible(self) -> bool:
        """Whether it changes the file, and compiles."""
        try:
            compile(self.source, self.file, "exec", dont_inherit=True)
        except (SyntaxError, ValueError):
            return False
        return self.source != (ROOT / self.file).read_text()

    @property
    def declares(self) -> bool:
        """Whether its line declares a number of a module."""
        return ": " in (line := (ROOT / self.file).read_text().splitlines()[self.line - 1]) and "= number(" in line

    @property
    def difference(self) -> str:
        """The changed lines, old and new."""
        old, new = (ROOT / self.file).read_text().splitlines(), self.source.splitlines()
        lines = list(difflib.unified_diff(old, new, n=0, lineterm=""))[3:]
        return "\n".join(line[0] + " " + line[1:].strip() for line in lines)

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.operator} {self.occurrence}"


def changed(source: str, operator: str, occurrence: int) -> str:
    return mutate_code(source, cosmic_ray.plugins.get_operator(f"core/{operator}")(), occurrence) or source


def mutants(file: str) -> Iterator[Mutant]:
    """All mutants of a file, by operator; some may not compile."""
    source = (ROOT / file).read_text()
    nodes = list(ast_nodes(get_ast(source)))
    for name in OPERATORS:
        operator = cosmic_ray.plugins.get_operator(f"core/{name}")()
        places = ((node, start) for node in nodes for start, _ in operator.mutation_positions(node))
        for occurrence, (node, (line, _)) in enumerate(places):
            if not is_untested(node) and not (is_index_zero(node) and name == "NumberReplacer" and occurrence % 2):
                yield Mutant(file, name, occurrence, line)


def is_index_zero(node: Any) -> bool:
    """Whether it is the 0 of `[0]`."""
    return node.parent.type == "trailer" and node.parent.children[0].value == "[" and node.get_code().strip() == "0"


def is_untested(node: Any) -> bool:
    """Whether it is part of a decorator, an annotation, a message or a list of parameters."""
    child = node
    while (parent := child.parent) is not None:
        annotation = (
            parent.type in ("tfpdef", "annassign") and child is parent.children[1 - 2 * (parent.type[0] == "t")]
        )
        returned = parent.type == "funcdef" and child is parent.annotation
        if annotation or returned or child.type in UNTESTED or (child is node and parent.type == "parameters"):
            return True
        child = parent
    return False


def sampled(files: list[str], count: int, seed: int) -> list[Mutant]:
    """About so many, of every file in proportion to what it has, at least one; in random order. 0: all of them."""
    found = {file: list(mutants(file)) for file in files}
    share = min(1.0, count / max(1, sum(map(len, found.values())))) if count else 1.0
    chosen = []
    for file, every in found.items():
        Random(f"{seed} {file}").shuffle(every)
        possible = (mutant for mutant in every if mutant.possible)
        chosen += itertools.islice(possible, max(1, round(share * len(every))))
    Random(seed).shuffle(chosen)
    return chosen
