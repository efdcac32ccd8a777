"""The site: it builds without a warning, its examples run and print what the pages show, its pictures are current."""

import ast
import contextlib
import importlib
import importlib.util
import io
import platform
import posixpath
import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Phase
from outlast.ecs import EngineError
from outlast.envs.cli.main import main, parser
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.training.plots.plot import compare
from outlast.training.research.compare import report
from outlast.training.research.results import group_runs, load_runs
from tests.conftest import COMPILED

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
RESULTS = ROOT / "results"
ORIGINAL = RESULTS / "original"
PAGES = {page.stem: page.read_text() for page in sorted(DOCS.glob("*.md"))}
TOOLS = ("sphinx", "myst_nb", "furo")
LARGEST_PICTURE, LARGEST_FILM, LARGEST_FOLDER = 60_000, 700_000, 3_000_000  # bytes
LONG = ("recipes", "torch")  # page and library of examples that train
PLAYED = ("sight", "fight", "tag")  # pictures of many ticks

# A MyST comment before a block is "% needs: MODULE" or "% not run: REASON"; a text block right after it is its output.
BLOCK = re.compile(
    r"(?P<marks>(?:^% [^\n]*\n\n?)?)^```python\n(?P<code>.*?)^```$(?:\n\n```text\n(?P<prints>.*?)^```$)?",
    re.MULTILINE | re.DOTALL,
)
NEEDS = re.compile(r"^% needs: (\w+)$", re.MULTILINE)

once = pytest.mark.skipif(
    not COMPILED or bool(numba.config.BOUNDSCHECK), reason="documents are the same in every mode; tested compiled"
)


def needed(block: re.Match[str]) -> str:
    """The additional library that a block needs, or ""."""
    found = NEEDS.search(block["marks"])
    return found[1] if found else ""


def cases() -> list[tuple[str, str]]:
    """Pages with examples, once for each library that some of them need."""
    found = [(page, needed(block)) for page, text in PAGES.items() for block in BLOCK.finditer(text)]
    return list(dict.fromkeys(found))


def run(page: str, library: str) -> None:
    """Run the examples of a page in order, in one namespace; errors name the page and the line."""
    namespace: dict[str, Any] = {"__name__": page}
    for block in BLOCK.finditer(PAGES[page]):
        if needed(block) != library or "% not run: " in block["marks"]:
            continue
        line = PAGES[page].count("\n", 0, block.start("code"))
        code = compile("\n" * line + block["code"], DOCS / f"{page}.md", "exec")
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            exec(code, namespace)
        if block["prints"] is not None:
            assert printed.getvalue().splitlines() == block["prints"].splitlines(), f"{page}.md, line {line}"
    for value in namespace.values():
        if isinstance(value, SurvivalVectorEnv):
            value.close()


@once
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(
    ("page", "library"), [case if case != LONG else pytest.param(*case, marks=pytest.mark.nightly) for case in cases()]
)
@pytest.mark.by_day(8)
def test_examples_run(page: str, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if library:
        pytest.importorskip(library)
    monkeypatch.syspath_prepend(str(DOCS / "examples"))
    monkeypatch.chdir(tmp_path)
    run(page, library)


def test_every_block_of_python_is_found() -> None:
    for page, text in PAGES.items():
        blocks = list(BLOCK.finditer(text))
        assert len(blocks) == len(re.findall(r"^```(?:python|py|pycon)$", text, re.MULTILINE)), page
        marked = [block for block in blocks if needed(block) or "% not run: " in block["marks"]]
        assert len(marked) == len(re.findall(r"^% ", text, re.MULTILINE)), page


EXAMPLES = sorted(path for path in (DOCS / "examples").glob("*.py") if not path.name.startswith("test_"))
PRIVATE = re.compile(r"outlast\.(?:envs|training)\b")


@pytest.mark.parametrize("page", [*PAGES, *(path.name for path in EXAMPLES)])
def test_examples_import_what_is_public(page: str) -> None:
    """Nothing below outlast.envs and outlast.training, but what the page about the API lists."""
    code = [block["code"] for block in BLOCK.finditer(PAGES.get(page, ""))]
    code += [path.read_text() for path in EXAMPLES if path.name == page]
    for node in (node for text in code for node in ast.walk(ast.parse(text))):
        if isinstance(node, ast.ImportFrom) and PRIVATE.match(node.module or ""):
            for name in node.names:
                assert re.search(rf"\b{node.module}\.{name.name}\b", PAGES["api"]), f"{node.module}.{name.name}"


def test_commands_are_understood() -> None:
    inline = [command for text in PAGES.values() for command in re.findall(r"`(outlast \w+[^`]*)`", text)]
    shell = [block for text in PAGES.values() for block in re.findall(r"^```bash\n(.*?)^```$", text, re.M | re.S)]
    fenced = [line for block in shell for line in re.findall(r"^(?:\S*/)?(outlast .*)$", block, re.M)]
    assert len(inline) > 2
    assert len(fenced) > 0
    for command in inline + fenced:
        parser().parse_args(shlex.split(command)[1:])


def test_tables_can_be_made(monkeypatch: pytest.MonkeyPatch) -> None:
    """All that pages ask for, without building the site, which takes a night."""
    for tool in TOOLS:
        pytest.importorskip(tool, reason=f"{tool} is not installed: pip install 'outlast[docs]'")
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    tables = importlib.import_module("tables").TABLES
    asked = {found for text in PAGES.values() for found in re.findall(r"^```\{outlast\} (.+)$", text, re.MULTILINE)}
    assert len(asked) > 20
    for name, *about in map(str.split, sorted(asked)):
        assert tables[name](*about).count("\n") > 2, name


def test_events_are_listed_with_those_who_emit_them(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    monkeypatch.syspath_prepend(str(DOCS / "_ext"))
    rows = [line.split(" | ") for line in importlib.import_module("catalogue").events().splitlines()]
    emits = {row[0].strip("| `"): row[-1].strip("| `") for row in rows}
    assert (emits["strike"], emits["death"], emits["hit"]) == ("Melee", "Mortality", "Melee`, `SafeZone")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The built pages."""
    for tool in TOOLS:
        if importlib.util.find_spec(tool) is None:
            pytest.skip(f"{tool} is not installed: pip install 'outlast[docs]'")
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-d", str(folder / "trees"), str(DOCS), str(folder / "html")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "html"


@pytest.mark.nightly
@once
def test_recordings_play_in_pages(site: Path) -> None:
    pages = {name for text in PAGES.values() for name in re.findall(r'<a href="([\w-]+\.html)">', text)}
    assert len(pages) == 4
    for name in pages if importlib.util.find_spec("torch") else {"replay.html"}:
        assert 50_000 < (site / name).stat().st_size < 1_000_000, name


@pytest.mark.nightly
@once
def test_the_site_has_all_that_there_is(site: Path) -> None:
    def words_of(page: str) -> set[str]:
        words = re.sub(r"<[^>]+>", " ", (site / f"{page}.html").read_text())
        return set(re.findall(r"\w+", words))

    for scenario in outlast.VARIANTS.values():
        assert scenario.numbers().keys() <= words_of("scenarios")
        assert {module.__class__.__name__ for module in scenario.modules} <= words_of("scenarios")
    assert {*outlast.VARIANTS, *outlast.envs.scenarios.variants.ALIASES} <= words_of("world")
    assert set(systems.__all__) <= words_of("scenarios")
    env = outlast.make_vec("ffa_3", 1, seed=0)
    assert {*env.single_observation_space, *(name for name, _ in env.action_columns)} <= words_of("spaces")


@pytest.mark.nightly
@once
@pytest.mark.parametrize("name", ["", ".errors", ".ecs", ".components", ".systems"])
def test_the_reference_has_every_public_name(site: Path, name: str) -> None:
    """With a signature, where it is a class or a function: as an entry that other sites can link to."""
    inventory = importlib.import_module("sphinx.util.inventory").InventoryFile
    with (site / "objects.inv").open("rb") as file:
        entries = inventory.load(file, "", posixpath.join)
    known = {name for kind, found in entries.items() if kind.startswith("py:") for name in found}
    module = importlib.import_module(f"outlast{name}")
    public = {f"outlast{name}.{own}" for own in module.__all__}
    errors = {f"outlast.ecs.{own}" for own in outlast.errors.__all__}  # they are documented where users catch them
    assert public - errors <= known


@pytest.mark.parametrize(
    ("page", "file", "right", "wrong"),
    [
        ("mechanic", "poison", ", after=Body", ""),
        ("tutorial", "tag", ", after=Body", ""),
        ("tutorial", "tag", "breath.left[e] -= 1", "breath.lef[e] -= 1"),
    ],
)
def test_errors_are_those_that_the_pages_show(page: str, file: str, right: str, wrong: str, tmp_path: Path) -> None:
    source = (DOCS / "examples" / f"{file}.py").read_text()
    assert source.count(right) == 1
    copy = tmp_path / f"{file}.py"
    copy.write_text(source.replace(right, wrong))
    mechanic = runpy.run_path(str(copy), run_name=file)[{"poison": "Poison", "tag": "Stamina"}[file]]
    with pytest.raises(EngineError) as refusal:
        outlast.make_vec(outlast.variant("ffa_3+steering").with_(mechanic()), 1)
    assert " ".join(str(refusal.value).split()) in " ".join(PAGES[page].split())


def test_every_phase_has_its_purpose_and_systems_that_exist(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(DOCS / "examples"))
    poison, tag = importlib.import_module("poison"), importlib.import_module("tag")
    section = re.search(r"^## Which phase\n(.*?)^## ", PAGES["mechanic"], re.MULTILINE | re.DOTALL)
    assert section is not None
    rows = re.findall(r"^\| [^|`]+ \| ([^|]+) \| ([^|]+) \|$", section[1], re.MULTILINE)
    kinds = [getattr(systems, name) for name in systems.__all__]
    labels = {s.label: s.phase for kind in (*kinds, poison.Poison, tag.Stamina) for s in kind().systems()}
    for phases, examples in rows:
        named = re.findall(r"`([A-Z]+)`", phases)
        assert {labels[example].name for example in re.findall(r"`(\w+\.\w+)`", examples)} <= {*named}
    assert [name for phases, _ in rows for name in re.findall(r"`([A-Z]+)`", phases)] == [p.name for p in Phase]


SCRIPT = runpy.run_path(str(DOCS / "pictures.py"))
PICTURES, FILMS = SCRIPT["PICTURES"], SCRIPT["films"]()  # functions that draw, and commands of pages, by name


LEARNED = {"hide_small.gif"}  # played by networks, whose actions may differ where another processor rounds otherwise


def test_pictures_are_small_and_shown() -> None:
    files = {file.name: file.stat().st_size for file in (DOCS / "pictures").iterdir()}
    drawn, taken = ({f"{name}.png" for name in which} for which in (PICTURES, SCRIPT["SCREENSHOTS"]))
    assert files.keys() == drawn | taken | FILMS.keys() | LEARNED
    assert max(files[name] for name in drawn) < LARGEST_PICTURE
    assert max(files[name] for name in taken) < 2 * LARGEST_PICTURE
    assert max(files.values()) < LARGEST_FILM
    assert sum(files.values()) < LARGEST_FOLDER
    shown = {name for text in PAGES.values() for name in re.findall(r"\(pictures/([\w.]+)\)", text)}
    assert shown == files.keys()


@once
@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.by_day(2)
def test_pictures_are_those_of_the_script(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """To update them: python docs/pictures.py"""
    if name in PLAYED and (sys.platform, platform.machine()) != ("linux", "x86_64"):
        pytest.skip("games may differ on machines with other sines")
    for game in ("tag", "tag_policy", "tag_view"):  # of one import, as in the script: other tests import them, too
        monkeypatch.delitem(sys.modules, game, raising=False)
    kept = cv2.imread(str(DOCS / "pictures" / f"{name}.png"))
    made = PICTURES[name]()[..., ::-1]
    assert kept is not None
    assert kept.shape == made.shape
    difference = float(np.abs(kept.astype(int) - made).mean())
    assert difference < 1  # of 255: edges may be smoothed a little differently elsewhere


@once
@pytest.mark.skipif((sys.platform, platform.machine()) != ("linux", "x86_64"), reason="sines differ elsewhere")
@pytest.mark.parametrize("name", FILMS)
@pytest.mark.by_day(2)
def test_films_are_those_of_the_commands(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To update one: the command of the page, or python docs/pictures.py NAME"""
    pytest.importorskip("imageio_ffmpeg", reason="a .gif needs FFmpeg: outlast[view]")
    command = FILMS[name]
    monkeypatch.chdir(ROOT)
    assert main([*command[:-1], str(tmp_path / name), "--quiet"]) == 0
    made, kept = (cv2.VideoCapture(str(folder / name)) for folder in (tmp_path, DOCS / "pictures"))
    count = 0
    while (frame := made.read())[0]:
        read, other = kept.read()
        assert read
        assert np.abs(frame[1].astype(int) - other).mean() < 3  # of 255: encoders differ
        count += 1
    assert count > 1
    assert not kept.read()[0]


def test_figures_of_training_show_the_kept_results() -> None:
    """To update them: the commands of paper.md and evaluating.md."""
    image = pytest.importorskip("PIL.Image", reason="Pillow comes with matplotlib: outlast[plot]")
    figures = pytest.importorskip("outlast.training.research.figures", reason="needs matplotlib: outlast[plot]")
    groups = group_runs(load_runs([ORIGINAL]))
    assert groups
    for group in groups:
        with image.open(ORIGINAL / f"{group.name}.png") as figure:
            assert figure.text["Source"] == figures.digest(group)
        assert (ORIGINAL / f"{group.name}.webm").exists()
    assert (ORIGINAL / "ends.md").read_text() == report(groups)
    text = RESULTS / "text"
    assert (text / "ends.md").read_text() == report(group_runs(load_runs([text])), groups)
    with image.open(RESULTS / "worlds-64/curves.png") as figure:
        compared = [place / "ffa_4-original-0" for place in (ORIGINAL, RESULTS / "worlds-64")]
        assert figure.text["Source"] == compare(compared).digest()
