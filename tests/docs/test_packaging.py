"""The wheel holds what is in the tree, under one name, and the tree keeps its own rules."""

import ast
import functools
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

import outlast
from outlast.systems.box2d.batch import CAPACITY
from tests.__main__ import checks

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]
FOLDERS = {name: ROOT / folder for name, folder in SETUPTOOLS["package-dir"].items()}

LARGEST = {"results": 12e6, "tree": 20e6, "wheel": 1.3e6, "archive": 5e6}  # bytes
TOP_LEVEL = {"ecs", "systems", "components", "envs", "training"}
# Libraries that a module may import though they are not installed.
OPTIONAL = "PIL benchmarl imageio_ffmpeg matplotlib minari pettingzoo pooch pufferlib pyarrow ray stable_baselines3 "
OPTIONAL += "tensorboard tensordict torch torchrl"

# Written in two parts, as this file is searched, too.
PLACES = re.compile(r"(?<![\w.])/(?:wor" + r"k|roo" + r"t)/")
REGISTRIES = re.compile("|".join(["pypi" + r"\.org", "python" + r"hosted\.", "npm" + r"js\.org", "deb" + r"ian\.org"]))


@functools.cache
def tracked() -> list[Path]:
    """Files in git, or not ignored by it."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("not a git checkout")
    files = (ROOT / name for name in listed.stdout.split("\0") if name)
    return sorted(path for path in files if path.is_file() and not path.is_symlink())


LEFT_OUT = "training/research"  # repeats the paper, from the repository
SHIPPED = (".css", ".csv", ".html", ".js", ".json", ".py", ".pyi", ".txt", ".xz")


def sources() -> dict[str, Path]:
    """Every file that belongs to the package, by its path in the wheel."""
    found = {}
    for package, folder in FOLDERS.items():
        for path in folder.rglob("*"):
            linked = package == "outlast" and len(path.relative_to(folder).parts) > 1
            shipped = path.suffix in SHIPPED or path.name == "py.typed"
            if shipped and not linked and not path.is_relative_to(ROOT / LEFT_OUT):
                found[f"{package.replace('.', '/')}/{path.relative_to(folder).as_posix()}"] = path
    return found


def modules() -> list[str]:
    """Every module of the package by its dotted name, except those that run when imported."""
    names = (name.removesuffix(".py") for name in sources() if name.endswith(".py"))
    return sorted(name.removesuffix("/__init__").replace("/", ".") for name in names if not name.endswith("__main__"))


def trees(word: str = "") -> dict[str, ast.Module]:
    """The syntax tree of every Python file in git that has this word, by its path."""
    texts = {path: path.read_text(encoding="utf-8") for path in tracked() if path.suffix == ".py"}
    return {path.relative_to(ROOT).as_posix(): ast.parse(text) for path, text in texts.items() if word in text}


def imported(tree: ast.Module) -> Iterator[tuple[str, str, str]]:
    """Absolute imports as (module, imported name or "", local name)."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((item.name, "", item.asname or item.name.split(".")[0]) for item in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield from ((node.module, item.name, item.asname or item.name) for item in node.names)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of what git has, as a build folder left in the tree would hide missing files."""
    place = tmp_path_factory.mktemp("tree")
    for path in tracked():
        copy = place / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
    return place


@pytest.fixture(scope="module")
def wheel(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    place = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--no-index", "--quiet"]
    built = subprocess.run([*command, "--wheel-dir", place, tree], capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = place.glob("*.whl")
    return zipfile.ZipFile(path)


@pytest.mark.nightly
def test_the_source_archive_holds_what_git_has(tree: Path, tmp_path: Path) -> None:
    """So that its tests run, with the data and documents that they read; see .ci/package, which runs them."""
    command = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", tmp_path, tree]
    built = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = tmp_path.glob("*.tar.gz")
    assert path.stat().st_size <= LARGEST["archive"]
    with tarfile.open(path) as archive:
        held = {name.partition("/")[2] for name in archive.getnames() if archive.getmember(name).isfile()}
    held = {name for name in held if name not in ("PKG-INFO", "setup.cfg") and not name.startswith("outlast.egg-info/")}
    here = {path.relative_to(ROOT).as_posix() for path in tracked()}
    left_out = (".git", ".devcontainer", ".dockerignore", "results/")
    assert held == {name for name in here if not name.startswith(left_out)}


@pytest.mark.nightly
def test_every_test_is_found_without_the_extras() -> None:
    program = (
        "import json, sys\n"
        "sys.modules.update(dict.fromkeys(json.loads(sys.argv[1])))\n"
        "import pytest\n"
        "sys.exit(pytest.main(['--collect-only', '-q', '-p', 'no:cacheprovider', '-m', '']))"
    )
    missing = [*OPTIONAL.split(), "hoptorch", "playwright", "pygame", "sb3_contrib", "supersuit"]
    command = [sys.executable, "-c", program, json.dumps(missing)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert "needs torch: outlast[train]" in done.stdout


@pytest.mark.nightly
def test_the_containers_steps_work(tmp_path: Path) -> None:
    text = (ROOT / "Dockerfile").read_text("utf-8")
    steps = [step.replace("/tmp/outlast", str(ROOT)) for step in re.findall(r"^RUN (.*)$", text, re.MULTILINE)]
    install, compiled, account = steps
    assert account.startswith("useradd")
    assert "\nENV OUTLAST_CACHE_DIR=/opt/outlast\n" in text
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    environment = {"PATH": f"{tmp_path / 'venv' / 'bin'}:{os.environ['PATH']}", "EXTRAS": "video"}
    environment |= {"HOME": str(tmp_path), "OUTLAST_CACHE_DIR": str(tmp_path / "opt")}
    (command,) = re.findall(r"^CMD (.*)$", text, re.MULTILINE)
    for step in (install.partition(" && rm ")[0], compiled, f"outlast {json.loads(command)[0]}"):
        done = subprocess.run(["bash", "-c", step], cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr[-3000:]
    assert all(name in done.stdout for name in outlast.VARIANTS)
    assert {path.stat().st_mode & 0o777 for path in (tmp_path / "opt").iterdir()} == {0o644}  # for every user


def test_documents_name_the_version() -> None:
    places = {
        "docs/project.md": r"version = \{(.+)\}",
        "CHANGELOG.md": r"^## (\d\S*)$",
        "CITATION.cff": "^version: (.+)$",
    }
    for name, pattern in places.items():
        found = re.findall(pattern, (ROOT / name).read_text("utf-8"), re.MULTILINE)
        assert found[0] == outlast.__version__, name


def test_fragments_of_the_changelog_are_one_line_each() -> None:
    kinds = {each["directory"] for each in PROJECT["tool"]["towncrier"]["type"]}
    for path in (ROOT / PROJECT["tool"]["towncrier"]["directory"]).iterdir():
        if path.name != "README.md":
            lines = path.read_text("utf-8").splitlines()
            assert re.fullmatch(rf"[\w-]+\.({'|'.join(kinds)})\.md", path.name), path
            assert len(lines) == 1, path
            assert len(lines[0]) <= 100, path


def test_pre_commit_runs_the_static_checks() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text("utf-8")
    stages = {stage.name.partition(" --")[0] for stage in checks()}
    assert stages <= set(re.findall(r"name: ([a-z -]+?)(?:,|$)", text, re.MULTILINE))


def test_the_citation_has_the_keys_that_its_format_demands() -> None:
    """See citation-file-format.github.io."""
    text = (ROOT / "CITATION.cff").read_text("utf-8")
    assert {"cff-version", "message", "title", "authors"} <= set(re.findall(r"^([\w-]+):", text, re.MULTILINE))


def test_what_everyone_downloads_is_small(wheel: zipfile.ZipFile) -> None:
    sizes = {path.relative_to(ROOT).as_posix(): path.stat().st_size for path in tracked()}
    assert sum(size for name, size in sizes.items() if name.startswith("results/")) <= LARGEST["results"]
    assert sum(sizes.values()) <= LARGEST["tree"]
    assert Path(str(wheel.filename)).stat().st_size <= LARGEST["wheel"]


def test_every_source_file_is_in_the_wheel(wheel: zipfile.ZipFile) -> None:
    shipped = {name for name in wheel.namelist() if ".dist-info/" not in name}
    assert shipped == set(sources())


def test_the_wheel_carries_its_licence_and_version(wheel: zipfile.ZipFile) -> None:
    version = re.search(r'__version__ = "(.+)"', (FOLDERS["outlast"] / "__init__.py").read_text(encoding="utf-8"))
    assert version
    info = f"outlast-{version[1]}.dist-info"
    assert f"{info}/licenses/LICENSE" in wheel.namelist()
    assert f"\nVersion: {version[1]}\n" in wheel.read(f"{info}/METADATA").decode()


def test_every_folder_with_sources_is_a_declared_package() -> None:
    holding = {name.rpartition("/")[0].replace("/", ".") for name in sources()}
    assert holding == set(SETUPTOOLS["packages"])


@pytest.mark.nightly
def test_importing_everything_leaves_no_second_copy() -> None:
    program = (
        "import importlib, json, sys\n"
        "for name in json.loads(sys.argv[1]):\n"
        "    try:\n"
        "        importlib.import_module(name)\n"
        "    except ModuleNotFoundError as error:\n"
        "        if error.name not in json.loads(sys.argv[2]): raise\n"
        "print(json.dumps(sorted(sys.modules)))\n"
    )
    arguments = [json.dumps(modules()), json.dumps(OPTIONAL.split())]
    done = subprocess.run([sys.executable, "-c", program, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not TOP_LEVEL & set(json.loads(done.stdout.splitlines()[-1]))


def test_inner_parts_of_numba_are_used_by_these_files_only() -> None:
    """They change between minor versions; those that make machine code are used by machine_code alone."""
    inner: dict[str, set[str]] = {}
    for path, tree in trees("numba").items():
        for module, name, _ in imported(tree) if path.startswith("ecs/") else ():
            if module.startswith(("numba.core", "numba.np")) or (module, name) == ("llvmlite", "ir"):
                inner.setdefault(Path(path).stem, set()).add(module)
    readers = "cache_key compile_errors source_check trial"
    writers = "arguments array_types by_role event jit machine_code simd vectors"
    assert sorted(inner) == sorted([*readers.split(), *writers.split()])
    assert [path for path, modules in inner.items() if "numba.core.codegen" in modules] == ["machine_code"]


def test_no_file_names_a_place_of_its_making() -> None:
    strays = []
    for path in tracked():
        content = path.read_bytes()
        if b"\0" not in content:
            text = content.decode("utf-8")
            strays += [
                f"{path.relative_to(ROOT)}: {hit[0]}" for rule in (PLACES, REGISTRIES) for hit in rule.finditer(text)
            ]
    assert not strays


def test_one_range_of_python_is_documented_everywhere() -> None:
    asked = SpecifierSet(PROJECT["project"]["requires-python"])
    versions = [f"3.{k}" for k in range(30) if f"3.{k}.0" in asked]
    classifiers = [line.rsplit(" ", 1)[-1] for line in PROJECT["project"]["classifiers"] if ":: Python :: 3." in line]
    assert classifiers == versions
    words = f"Python {', '.join(versions[:-1])} or {versions[-1]}"
    for page in ("README.md", "docs/start.md"):
        assert words in (ROOT / page).read_text(encoding="utf-8"), page
    assert f"Python {versions[0]} to {versions[-1]}" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")


PLATFORMS = ("linux x86_64", "linux aarch64", "darwin arm64", "darwin x86_64", "win32 AMD64", "win32 ARM64")


@pytest.mark.parametrize("python", ["3.11", "3.13", "3.14"])
@pytest.mark.parametrize("place", PLATFORMS)
def test_one_package_of_box2d_is_asked_for_which_has_a_wheel(place: str, python: str) -> None:
    """Box2D 2.3.10 has none for Linux and Windows on ARM, nor for Python 3.14; ufal-pybox2d 2.3.10.5 has all these."""
    system, machine = place.split()
    here = {"sys_platform": system, "platform_machine": machine, "python_version": python}
    asked = [Requirement(line) for line in PROJECT["project"]["dependencies"]]
    choices = [each for each in asked if "box2d" in each.name.lower() and each.marker]
    found = [each.name for each in choices if each.marker.evaluate(here)]
    lacking = python == "3.14" or machine in ("aarch64", "ARM64")
    assert found == ["ufal-pybox2d" if lacking else "Box2D"]


def test_documented_extras_exist() -> None:
    named = set()
    for path in tracked():
        if path.suffix in (".md", ".py"):
            text = path.read_text("utf-8")
            named |= set(re.findall(r"pip install (?:-\S+ )*'(?:outlast|\.)\[(\w[\w-]*)\]'", text))
            named |= set(re.findall(r"""(?:install\('|needed\(")([\w-]+)""", text))  # of envs.errors, in messages
    assert named > {"train", "view", "test"}
    extras = PROJECT["project"]["optional-dependencies"].keys()
    assert named <= extras
    page = (ROOT / "docs" / "troubleshooting.md").read_text("utf-8")
    listed = set(re.findall(r"^\| `([\w-]+)` \| ", page, re.MULTILINE))
    assert listed == extras - {"mutation", "test-core", "test-ray"}  # these are for outlast's own development


def test_the_limit_of_bodies_is_documented() -> None:
    assert f"room for {CAPACITY} bodies" in (ROOT / "docs" / "scenarios.md").read_text(encoding="utf-8")
