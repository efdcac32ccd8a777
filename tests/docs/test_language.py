"""The language of docstrings: functions begin with a verb, classes and modules with a noun phrase; few tics."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILES = [file for name in ("ecs", "components", "systems", "envs", "training") for file in (ROOT / name).rglob("*.py")]
QUESTIONS = {"how", "of", "that", "what", "when", "where", "whether", "which", "who", "whom", "whose", "why"}
NOUNS = QUESTIONS | {"a", "all", "an", "both", "every", "for", "in", "its", "no", "none", "one", "the", "these", "this"}
TICS = {  # words that hide who does what, and the most of them in 100,000 words
    r"(?:is|are) no \w+": 10,
    r"there (?:is no|are no|is none|are none)": 10,
    r"says?|said|tells?|told": 14,
    r"nobody|somebody|everybody": 10,
    r"whoever|whatever|whom": 10,
    r"whole": 16,
    r"mended|meanwhile|likewise|so many": 8,
}


def test_docstrings_begin_with_a_verb_or_a_noun() -> None:
    wrong = []
    for file in FILES:
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
                continue
            words = (ast.get_docstring(node) or "-").split()
            decorators = {ast.unparse(each).rpartition(".")[2] for each in getattr(node, "decorator_list", ())}
            function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            verb = function and not decorators & {"property", "cached_property", "setter"}
            if words[0].strip(".,:;").lower() in (NOUNS if verb else QUESTIONS):
                wrong.append(f"{file.relative_to(ROOT)}:{getattr(node, 'lineno', 1)}: {' '.join(words[:9])}")
    assert not wrong, "\n".join(wrong)


def test_tics_are_few() -> None:
    text = "\n".join(file.read_text("utf-8") for file in FILES)
    words = len(re.findall(r"\w+", text))
    found = {tic: len(re.findall(rf"\b(?:{tic})\b", text, re.IGNORECASE)) / words * 1e5 for tic in TICS}
    assert {tic: round(rate, 1) for tic, rate in found.items() if rate > TICS[tic]} == {}
