"""The policies in docs/results, as checkpoints of today's game."""

import json
import zipfile
from pathlib import Path

from outlast import variant
from outlast.envs.scenarios.fingerprint import fingerprint

RESULTS = Path(__file__).parents[2] / "docs" / "results"
HEADER = "run.json"


def kept_policy(path: Path, name: str = "teams_3-original-0") -> Path:
    """The policy of that name at `path`, as if it had been trained in the variant as it is today."""
    plain = variant(name.partition("-")[0])
    scenario = plain.replace(cameras_mode="revealed").titled_as(plain)
    with zipfile.ZipFile(RESULTS / f"{name}.zip") as kept, zipfile.ZipFile(path, "w") as archive:
        header = json.loads(kept.read(HEADER)) | {"scenario": fingerprint(scenario)}
        archive.writestr(HEADER, json.dumps(header))
        for entry in kept.namelist():
            if entry != HEADER:
                archive.writestr(entry, kept.read(entry))
    return path
