"""Models by name: the table, and files from a checkout, a folder or a server, or from none of them."""

import contextlib
import functools
import hashlib
import http.server
import subprocess
import sys
import threading
from collections.abc import Iterator
from email.message import Message
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.envs.errors import UsageError
from outlast.envs.rollout import saved
from outlast.envs.rollout.lineup import checked_entries, parse_lineup
from outlast.envs.rollout.saved import CHECKPOINT, checkpoints, fetched, is_saved, located, models, policy_file, text_of
from tests.conftest import run

NAME = "teams_3/fast-0"
LONG = "teams_2+health_cap+team_share+bounty+steering+give_last_reach=10/pool-0"  # whose address has %2B and %3D
ADDRESS, RESULTS = saved.ADDRESS, saved.RESULTS
needs_results = pytest.mark.skipif(not RESULTS.is_dir(), reason="results are not part of this archive")


@contextlib.contextmanager
def served(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """The address of a server of a folder's files, and the lines that it logs: one for each request."""
    asked: list[str] = []

    class Handler(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *given: Any) -> None:
            asked.append(self.path)

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Handler, directory=folder)) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_address[1]}", asked
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def empty_cache(monkeypatch, tmp_path: Path) -> None:
    """No model is in the cache."""
    pytest.importorskip("pooch", reason="needs pooch: outlast[train]")
    if not RESULTS.is_dir():
        pytest.skip("results are not part of this archive")
    monkeypatch.setenv("OUTLAST_CACHE_DIR", str(tmp_path / "cache"))


def cached(tmp_path: Path) -> list[str]:
    """The names of the files in the cache."""
    return sorted(path.name for path in (tmp_path / "cache").rglob("*") if path.is_file())


def described(address: str) -> Message:
    """The metadata of a package with one address."""
    about = Message()
    about["Project-URL"] = address
    return about


@needs_results
def test_the_table_has_a_row_for_each_file() -> None:
    files = {path.relative_to(RESULTS).as_posix(): path for path in (RESULTS / "policies").rglob("*.safetensors")}
    assert files.keys() == {model.file for model in models().values()}
    for model in models().values():
        content = files[model.file].read_bytes()
        assert (model.size, model.sha256) == (len(content), hashlib.sha256(content).hexdigest()), model.name
        assert 0 <= model.wins <= 1


@needs_results
def test_the_table_agrees_with_the_headers() -> None:
    pytest.importorskip("safetensors", reason="needs safetensors: outlast[train]")
    from outlast.training.base.policy_file import read_header

    for model in models().values():
        header = read_header(RESULTS / model.file, ("plan", "steps", "preset"))
        told = header["preset"], header["plan"]["seed"], header["steps"]
        assert (model.preset, model.seed, model.steps) == told, model.name


def test_they_are_listed(capsys) -> None:
    status, out, err = run(capsys, "models")
    head, *lines = out.splitlines()
    assert (status, err, head.split()[-1]) == (0, "", "name")
    assert [line.split()[-1] for line in lines] == [*models()]
    (line,) = (line for line in lines if line.endswith(f" {NAME}"))
    known = models()[NAME]
    numbers = [f"{known.steps:,}", f"{known.wins:.3f}", f"{known.size:,}", known.sha256[:12]]
    assert line.split() == [known.preset, "0", *numbers, NAME]
    with pytest.raises(UsageError, match="no policy is named"):
        located("")


def test_a_name_is_a_model_and_a_path_is_a_path(tmp_path: Path, monkeypatch) -> None:
    """Whatever is in the working directory; a folder of that name is meant by "./" in front, or by a Path."""
    monkeypatch.chdir(tmp_path)
    Path(NAME).mkdir(parents=True)
    (newest := Path(NAME, "steps_0000000512.zip")).touch()
    assert parse_lineup(f"{NAME}:2,scripted") == {NAME: 2.0, "scripted": 1.0}
    assert (policy_file(NAME, ()), is_saved(NAME), text_of(NAME)) == (NAME, True, NAME)
    for given in (f"./{NAME}", Path(NAME)):
        assert located(given) == newest
        assert checked_entries([(given, 1)]) == [(str(newest), 1.0)]
    assert not is_saved(f"./{NAME}")
    assert checked_entries([(NAME, 1), (f"./{NAME}", 1)]) == [(NAME, 1.0), (str(newest), 1.0)]


@pytest.mark.parametrize(
    ("name", "meant"), [("teams_3/fast-9", NAME), ("teams_3/fst-0", NAME), ("runs/COIN-fast-0", r"runs/coin-fast-0\? ")]
)
def test_unknown_names_are_refused(name: str, meant: str, tmp_path: Path, monkeypatch) -> None:
    """A path is compared with what is beside it."""
    monkeypatch.chdir(tmp_path)
    Path("runs/coin-fast-0").mkdir(parents=True)
    words = rf"did you mean {meant}.*a model's name, FILE\.zip, .* is needed"
    for ask in (located, parse_lineup):
        with pytest.raises(UsageError, match=rf"{name}: {words}"):
            ask(name)


@needs_results
def test_they_are_found_in_a_checkout_also_by_an_installed_outlast(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pooch", None)
    assert fetched(NAME) == located(NAME) == RESULTS / "policies" / f"{NAME}.safetensors"
    monkeypatch.delenv(ADDRESS, raising=False)
    monkeypatch.setattr(saved, "RESULTS", tmp_path / "nowhere")
    monkeypatch.chdir(RESULTS.parent)
    assert fetched(NAME).resolve() == RESULTS / models()[NAME].file


@pytest.mark.usefixtures("empty_cache")
@pytest.mark.parametrize("name", [NAME, LONG])
def test_they_are_downloaded_once(monkeypatch, tmp_path: Path, name: str) -> None:
    with served(RESULTS) as (address, asked):
        monkeypatch.setenv(ADDRESS, address)
        first = fetched(name)
        assert first.read_bytes() == (RESULTS / models()[name].file).read_bytes()
        assert first.is_relative_to(tmp_path / "cache")
        assert fetched(name) == first
        assert len(asked) == 1
        first.write_bytes(b"broken")  # as by a full disk
        assert fetched(name) == first
        assert hashlib.sha256(first.read_bytes()).hexdigest() == models()[name].sha256
        assert len(asked) == 2
    assert fetched(name) == first


@pytest.mark.usefixtures("empty_cache")
def test_nothing_stays_of_a_download_that_fails(monkeypatch, tmp_path: Path) -> None:
    """A server without the file, one with another file of that name, and one that has stopped."""

    def refused(words: str) -> None:
        with pytest.raises(UsageError, match=words) as error:
            fetched(NAME)
        assert len(str(error.value).splitlines()) == 1
        assert cached(tmp_path) == []
        if (response := getattr(error.value.__cause__, "response", None)) is not None:
            response.close()  # else its socket waits for the garbage collector

    with served(tmp_path / "here") as (address, _):
        monkeypatch.setenv(ADDRESS, address)
        refused(rf"{NAME} cannot be downloaded from http.*: 404 .*; connect .* {ADDRESS}")
        (tmp_path / "here" / models()[NAME].file).parent.mkdir(parents=True)
        (tmp_path / "here" / models()[NAME].file).write_bytes(b"another")
        refused(rf"{NAME}: the file at http.* is another one, by its checksum; nothing was kept; set {ADDRESS}")
    refused(rf"{NAME} cannot be downloaded from .*; connect to the .*, or set {ADDRESS}")


def test_without_pooch_the_message_names_the_cure(monkeypatch) -> None:
    monkeypatch.setenv(ADDRESS, "http://127.0.0.1:9/results")
    monkeypatch.setitem(sys.modules, "pooch", None)
    with pytest.raises(UsageError, match=rf"{NAME} is downloaded by pooch: pip install 'outlast\[train\]'"):
        fetched(NAME)


@needs_results
@pytest.mark.parametrize("form", [str, Path.as_uri])
def test_a_folder_may_hold_them(form: Any, tmp_path: Path, monkeypatch) -> None:
    there = tmp_path / "a b" / models()[NAME].file
    there.parent.mkdir(parents=True)
    monkeypatch.setenv(ADDRESS, form(tmp_path / "a b"))
    with pytest.raises(UsageError, match=rf"{NAME}: .* cannot be read \(No such file .*\): set {ADDRESS} to a folder"):
        fetched(NAME)
    there.write_bytes((RESULTS / models()[NAME].file).read_bytes())
    assert fetched(NAME) == there
    there.write_bytes(b"another")
    with pytest.raises(UsageError, match=f"{NAME}: .* is not the file that was kept, by its checksum: restore it"):
        fetched(NAME)


@pytest.mark.parametrize(
    ("address", "message"),
    [("http://[", "which is not an address"), ("ftp://x/", "an address of http, https or file is needed")],
)
def test_an_address_that_is_none_is_refused(monkeypatch, address: str, message: str) -> None:
    monkeypatch.setenv(ADDRESS, address)
    with pytest.raises(UsageError, match=rf"{NAME}: {ADDRESS} .*{message}"):
        fetched(NAME)


def test_an_installed_outlast_uses_the_address_of_its_metadata(monkeypatch, tmp_path: Path) -> None:
    asked = list[str]()
    monkeypatch.delenv(ADDRESS, raising=False)
    monkeypatch.setattr(saved, "RESULTS", tmp_path / "nowhere")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(saved, "_downloaded", lambda address, *given: asked.append(address))
    monkeypatch.setattr(saved, "metadata", lambda name: described("Source, https://host/outlast"))
    with pytest.raises(UsageError, match=f"{NAME}: an installed .* no address of them: set {ADDRESS} to a"):
        fetched(NAME)
    monkeypatch.setattr(saved, "metadata", lambda name: described("Results, https://host/raw/results"))
    fetched(NAME)
    fetched(LONG)
    name = LONG.replace("+", "%2B").replace("=", "%3D")
    assert asked == [f"https://host/raw/results/policies/{each}.safetensors" for each in (NAME, name)]


@needs_results
def test_models_play_wherever_policies_do(capsys) -> None:
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    pytest.importorskip("safetensors", reason="needs safetensors: outlast[train]")
    from outlast.training.base.config import TrainingConfig, parse_warm_start
    from outlast.training.ppo.trainer import Trainer

    player = outlast.load_policy(NAME)
    assert (player.header["steps"], player.critic) == (models()[NAME].steps, True)
    small = ("--worlds=2", "--steps=10", "--quiet")
    for policy, others in ((NAME, "scripted"), ("scripted", f"{NAME}:2,noop:1")):
        status, out, _ = run(capsys, "rollout", "teams_3", "--policy", policy, "--others", others, *small)
        assert (status, NAME in out) == (0, True)
    found = outlast.evaluate("teams_3", [NAME, "teams_3/original-1"], episodes=2, worlds=2, quiet=True)
    labels = [("fast-0", NAME), ("original-1", "teams_3/original-1")]
    assert [(each.label, each.text) for each in found.chosen] == labels
    config = functools.partial(TrainingConfig, outlast.variant("teams_3"), worlds=2, rollout=64)
    against = Trainer(config(opponents={"self": 1.0, NAME: 1.0}))
    against.collect()
    assert against.config.header()["plan"]["opponents"] == f"self:1,{NAME}:1"
    assert [parse_warm_start(text) for text in (NAME, f"{NAME}:2e6")] == [(NAME, 0), (NAME, 2_000_000)]
    begun = Trainer(config(warm_start=NAME))
    begun.take_weights()
    assert begun.config.header()["plan"]["warm_start"] == NAME


def test_checkpoints_are_in_order_of_their_steps(tmp_path: Path) -> None:
    names = [CHECKPOINT.format(steps) for steps in (512, 9_999_999_999, 10_000_007_168)]
    for name in (*names, "steps_good.zip", "steps_0000000600.zip.part", "steps_.zip"):
        tmp_path.joinpath(name).touch()
    assert [path.name for path in checkpoints(tmp_path)] == names


def test_without_torch_the_message_names_the_cure() -> None:
    code = "import sys; sys.modules['torch'] = None; from outlast.envs.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "rollout", "ffa_1", "--policy", "a.zip"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == 2
    cure = "pip install 'outlast[train]' (pooch>=1.8, safetensors>=0.4.3, tensorboard>=2.16, torch>=2.4)"
    assert result.stderr == f"outlast: a.zip needs torch: {cure}\n"
