"""Notebooks: those of the site run and are stored whole, and things show themselves in them."""

import html
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import outlast
from outlast.envs.rollout.summary import Summary
from tests.conftest import COMPILED, digest

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


def outputs(path: Path) -> list[tuple[str, list[dict[str, Any]]]]:
    """The source and the outputs of every cell with code."""
    cells = [cell for cell in json.loads(path.read_text("utf-8"))["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    return [("".join(cell["source"]), cell["outputs"]) for cell in cells]


def printed(path: Path) -> list[str]:
    return ["".join(output["text"]) for _, found in outputs(path) for output in found if "text" in output]


@pytest.mark.nightly
@pytest.mark.skipif(not COMPILED, reason="documents are the same in every mode; tested compiled")
def test_notebooks_run(tmp_path: Path) -> None:
    """From the first cell to the last, and the first one prints what is stored; the second one trains less here."""
    for library in ("nbclient", "ipykernel", "matplotlib", "torch"):
        pytest.importorskip(library, reason=f"needs {library}: outlast[docs,train]")
    command = [sys.executable, FOLDER.with_suffix(".py"), "--steps", "100000", "--out", tmp_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    for path in NOTEBOOKS:
        kinds = [[sorted(output.get("data", ())) for output in found] for _, found in outputs(tmp_path / path.name)]
        assert kinds == [[sorted(output.get("data", ())) for output in found] for _, found in outputs(path)]
    assert printed(tmp_path / "first_ten_minutes.ipynb") == printed(FOLDER / "first_ten_minutes.ipynb")


def test_what_is_stored_was_made_by_what_is_stored() -> None:
    assert len(NOTEBOOKS) == 2
    for path in NOTEBOOKS:
        assert not any(output["output_type"] == "error" or output.get("name") == "stderr"
                       for _, found in outputs(path) for output in found)  # fmt: skip


def test_environments_show_their_first_world_once_there_is_one() -> None:
    env = outlast.make_vec("teams_3", 2, seed=4)
    agents = outlast.adapters.make_agents("teams_3", 2, seed=4)
    for each in (env, agents):
        assert each._repr_png_() is None
        each.reset()
        batch = getattr(each, "base_env", each)
        before = digest(batch.worlds)
        shown = cv2.imdecode(np.frombuffer(each._repr_png_(), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
        assert np.array_equal(shown, outlast.draw(batch.worlds, 0))
        assert digest(batch.worlds) == before
        each.close()
        assert each._repr_png_() is None


def test_recordings_show_a_page_in_a_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from outlast.envs.web import pages as notebook

    env = outlast.make_vec("ffa_2", 2, seed=1)
    with outlast.record(env, tmp_path / "two.rec"):
        env.reset()
        for _ in range(12):
            env.step(np.broadcast_to(env.noop, (2, env.num_agents, 6)))
    recording = outlast.Recording.open(tmp_path / "two.rec")
    (tmp_path / "cut.rec").write_bytes((tmp_path / "two.rec").read_bytes()[: recording._chunks[0].offset])
    assert outlast.Recording.open(tmp_path / "cut.rec")._repr_html_().startswith("<p>&lt;Recording")
    page = outlast.replay_page(recording, tmp_path / "page.html").read_text("utf-8")
    shown = recording._repr_html_()
    frame = re.fullmatch(r'<iframe srcdoc="([^"]*)" [^<>]*></iframe>', shown)
    assert frame
    assert html.unescape(frame[1]) == page
    assert outlast.Replay(recording)._repr_html_() == shown
    monkeypatch.setattr(notebook, "MOST", 5)
    assert recording._repr_html_().endswith("<p>The first 5 of 12 ticks; outlast.replay_page shows others.</p>")


def test_summaries_are_tables() -> None:
    summary = outlast.rollout("ffa_2", policy="random", others="noop", worlds=4, steps=0, episodes=1, ending_limit=5)
    shown = summary._repr_html_()
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", shown)
    assert cells[:4] == ["per episode", "mean", "std. error", "episodes"]  # the last, as nobody dies
    assert cells[4::4] == [name for name, _, _ in summary.rows()]
    assert cells[cells.index("first_death") :][:4] == ["first_death", "-", "-", "0"]
    assert "<pre>" in shown
    assert repr(summary) == str(summary)
    assert Summary()._repr_html_() == "<p>no episode ended: statistics are of whole episodes, which take more steps</p>"
