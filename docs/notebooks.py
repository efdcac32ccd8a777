"""Execute the notebooks of the site and keep their outputs in them: `python docs/notebooks.py`.

They are written by hand, without outputs. This runs every cell in a new kernel and stores the outputs, which the site
shows. `--steps` shortens the training in the second notebook; the stored outputs were made without it.
"""

import argparse
import base64
import re
from pathlib import Path

import cv2
import nbformat
import numpy as np
from nbclient import NotebookClient
from pictures import small_png

FOLDER = Path(__file__).parent / "notebooks"
PNG = "image/png"
STEPS = re.compile(r"^steps = [\d_]+", re.MULTILINE)


def executed(path: Path, steps: int | None = None) -> nbformat.NotebookNode:
    """Return the notebook with its outputs. Raises nbclient's CellExecutionError, with the cell and its traceback."""
    notebook = nbformat.read(path, as_version=4)
    if steps:
        for cell in notebook.cells:
            cell.source = STEPS.sub(f"steps = {steps}", cell.source)
    NotebookClient(notebook, timeout=1200, resources={"metadata": {"path": str(path.parent)}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # the times at which it ran differ in each run
        for output in cell.get("outputs", ()):
            if picture := output.get("data", {}).get(PNG):
                output.data[PNG] = smaller(picture)
    return notebook


def smaller(picture: str) -> str:
    """A PNG in base64, as one of few colours."""
    content = np.frombuffer(base64.b64decode(picture), np.uint8)
    return base64.b64encode(small_png(cv2.imdecode(content, cv2.IMREAD_COLOR_RGB))).decode()


def main() -> None:
    parser = argparse.ArgumentParser("python docs/notebooks.py", description=__doc__)
    parser.add_argument("--steps", type=int, help="agent-steps to train for (default: as the notebook says)")
    parser.add_argument(
        "--out", type=Path, default=FOLDER, help="folder for the executed notebooks (default: docs/notebooks)"
    )
    options = parser.parse_args()
    for path in sorted(FOLDER.glob("*.ipynb")):
        nbformat.write(executed(path, options.steps), options.out / path.name)
        print(options.out / path.name, flush=True)


if __name__ == "__main__":
    main()
