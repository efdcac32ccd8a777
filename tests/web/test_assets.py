"""Pages take their colours and sizes from rendering/style.py: none is written in JavaScript or in a style sheet."""

import dataclasses
import json
import re
from pathlib import Path

import pytest

from outlast.envs.rendering.style import SIZES
from outlast.envs.web import assets

WEB = Path(assets.__file__).parent
SCRIPTS = {path.name: path.read_text(encoding="utf-8") for path in WEB.rglob("*.js")}
DRAWING = ("brush.js", "bodies.js", "world.js")


@pytest.mark.parametrize("path", [*WEB.rglob("*.js"), *WEB.rglob("*.css")], ids=lambda path: path.name)
def test_no_colour_is_written_by_hand(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert not re.findall(r"#[0-9a-fA-F]{3,8}\b(?=[\"';,) ])", text)
    assert not re.findall(r"\b(?:rgb|hsl)a?\((?!0 0 0 / )", text)  # shadows are black


@pytest.mark.parametrize("name", DRAWING)
def test_no_shared_size_is_written_by_hand(name: str) -> None:
    """But for 0.5, which is also half of anything."""
    shared = {abs(float(number)) for number in re.findall(r"-?\d+\.\d+", json.dumps(dataclasses.asdict(SIZES)))} - {0.5}
    code = re.sub(r"//.*", "", SCRIPTS[name])
    assert not shared & {float(number) for number in re.findall(r"(?<![\w.])\d+\.\d+", code)} - {0.0, 1.0}


def test_scripts_use_constants_that_there_are() -> None:
    text = "".join(SCRIPTS.values())
    taken = re.findall(r"\{([^{}]+)\} = SIZES", text)
    sizes = {*re.findall(r"SIZES\.(\w+)", text), *re.findall(r"(\w+):", " ".join(taken))}
    names = {field.name for field in dataclasses.fields(SIZES)}
    assert sizes <= names
    assert names - sizes == {"margin"}  # which is in a world's description
    colors = set(re.findall(r"\bcolors\.(\w+)", text))
    assert len(colors) > 10
    for theme in assets.THEMES.values():
        assert colors <= {*assets.COMMON, *theme}
