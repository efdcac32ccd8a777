"""Samples as a Minari dataset, with an episode for each agent of each episode of a world."""

import contextlib
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec

from outlast.ecs import Clock

from ..adapters.base import Info
from ..adapters.gymnasium_single import Observation, SurvivalEnv
from ..adapters.registry import VERSION
from ..core.action_spaces import ActionSpace
from ..core.numbers import current_levels
from ..core.observations import Observations
from ..errors import RecordingError, needed
from ..levels import Level, decoded, encoded
from ..recording import Replay
from ..scenarios.fingerprint import rebuilt
from ..storage import outputs
from ..storage.outputs import check_folder, written_to
from .samples import DatasetSamples, Selection, concatenate, manifest, read_samples

with needed("data", "Minari datasets need Minari", RecordingError):
    import minari
    import pyarrow  # noqa: F401 - what Minari writes with
    from minari.data_collector.episode_buffer import EpisodeBuffer
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.namespace import create_namespace, list_local_namespaces
    from minari.storage.datasets_root_dir import get_dataset_path

ROOT = "MINARI_DATASETS_PATH"  # the environment variable with the folder of Minari's datasets


def new_place(name: str) -> Path:
    """Return the folder of a new dataset. Raises RecordingError if it exists, or the name is not possible."""
    try:
        parse_dataset_id(name)
    except (ValueError, TypeError):
        raise RecordingError(
            f"{name!r} is not a name of a Minari dataset: NAME-v0 is needed, or SPACE/NAME-v0 with two or more letters "
            "in SPACE"
        ) from None
    with written_to(os.environ.get(ROOT, name), RecordingError, "; no dataset was written"):
        place = Path(get_dataset_path(name))
    if place.exists():
        raise RecordingError(f"there is a Minari dataset {name}; give another name, or `minari delete {name}`")
    check_folder(place.parent, RecordingError)
    return place


def export_minari(name: str, replay: Replay, selection: Selection) -> int:
    """Write the local dataset `name` in Minari's format "arrow", and return the number of agent-steps.

    Episodes that a reset or the end of the recording cut off count as truncated. Metadata have a seed, and options with
    world, episode, agent and level, from which a `RecordedEnv`, which `recover_environment` makes, begins the episode
    again. What has no numbers, as `others` in a game of one agent, is left out, because Arrow divides by its size.
    """
    place, count = new_place(name), [0]
    seen = Observations(replay.worlds, "dict", scaled=False).of_agent(0)
    about = manifest(replay)
    own = EnvSpec(
        f"outlast/recorded-{VERSION}",
        entry_point=f"{__name__}:{recovered.__name__}",
        kwargs={"game": about["scenario"], "mechanics": about["mechanics"], "dead": "keep"},  # as in its episodes
    )
    with _staged(name, place), warnings.catch_warnings():
        # Minari warns about a missing link to the code, which is in a released package
        warnings.simplefilter("ignore", UserWarning)
        minari.create_dataset_from_buffers(
            name,
            _episodes(replay, selection, count),  # an iterator: episodes are not all in memory at once
            env=own,
            observation_space=spaces.Dict({key: box for key, box in seen.items() if all(box.shape)}),
            action_space=ActionSpace(replay.worlds, "multi").single,
            description=f"outlast {about['outlast']}, {about['scenario']['name']}: {about['scenario']['numbers']}",
            data_format="arrow",
            requirements=[f"outlast=={about['outlast']}"],
        )
    return count[0]


def recovered(game: dict[str, Any], mechanics: list[str], **options: Any) -> gymnasium.Env[Any, Any]:
    """Return the environment of a dataset: one agent of the recorded scenario, as in `gymnasium.make("outlast/...")`.

    game, mechanics: The scenario, and the full names of the classes of its mechanics, as in recordings; ScenarioError
    if they cannot be imported here. options: Those of `SurvivalEnv` given to `recover_environment`.
    """
    return RecordedEnv(rebuilt(game, mechanics), **options)


class RecordedEnv(SurvivalEnv):
    """A SurvivalEnv whose `reset` can begin an episode of a dataset; see `recovered`.

    >>> known = dataset.storage.get_episode_metadata([0])[0]
    >>> env = dataset.recover_environment(learner=known["options"]["agent"])
    >>> env.reset(seed=known["seed"], options=known["options"])
    """

    def reset(self, *, seed: int | None = None, options: Info | None = None) -> tuple[Observation, Info]:
        """Start the episode that metadata describe; without options, start an episode as SurvivalEnv does.

        Raises ValueError if the options are not those of an episode, or it is another agent's or seed's.
        """
        if not options:
            return super().reset(seed=seed)
        try:
            (level,), agent = decoded([options["level"]]), options["agent"]
            own, world, episode = options["level"]["key"]
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ValueError(f"options: those in the metadata of an episode are needed: {error!r}") from None
        if (agent, own) != (self._batch.learner, seed):
            made = f"agent {self._batch.learner} and reset(seed={seed}); make it with learner={agent}"
            raise ValueError(f"the episode is of agent {agent} and seed {own}, not {made}")
        worlds = self.base_env.worlds
        if worlds.layout.keyed:
            self.base_env.set_levels([level])
        else:
            worlds.seed(own, world)
            worlds[Clock].episode[0] = episode - 1  # the reset counts on
        return super().reset()


@contextlib.contextmanager
def _staged(name: str, place: Path) -> Iterator[None]:
    """Let Minari write into a hidden folder, and move the complete dataset from there to its place."""
    root, kept = Path(get_dataset_path()), os.environ.get(ROOT)
    hidden = outputs.temporary_path(root / place.name)
    hidden.mkdir()
    try:
        try:
            os.environ[ROOT] = str(hidden)
            yield
        finally:
            os.environ.pop(ROOT, None)  # Ctrl-C may have come before it was set
            os.environ.update({} if kept is None else {ROOT: kept})
        if (namespace := parse_dataset_id(name)[0]) and namespace not in list_local_namespaces():
            create_namespace(namespace)
        place.parent.mkdir(parents=True, exist_ok=True)
        outputs.replace(hidden / name, place)
    finally:
        outputs.remove(hidden)


def _episodes(replay: Replay, selection: Selection, count: list[int]) -> Iterator[Any]:
    """Yield the episodes of all agents, in the order in which they end. count[0]: the agent-steps so far."""
    running: dict[int, list[DatasetSamples]] = {}
    for batch in read_samples(replay, selection):
        last = batch.columns["last"]
        for k, world in enumerate(batch.columns["world"].tolist()):
            running.setdefault(world, []).append(batch.row(k))
            if last[k]:
                episode = concatenate(running.pop(world))
                own = np.arange(replay.worlds.count) == world - replay.recording.first_world
                (level,) = current_levels(replay.worlds, own)
                for i in np.flatnonzero(episode.present[0]).tolist():
                    count[0] += len(episode)
                    yield _episode(episode, i, level)


def _episode(found: DatasetSamples, i: int, level: Level) -> Any:
    columns = found.columns
    truncated = columns["truncated"].copy()
    truncated[-1] |= not columns["terminated"][-1]
    return EpisodeBuffer(
        observations={
            key: np.concatenate([a[:, i], found.final[key][:, i]]) for key, a in found.observations.items() if a.size
        },
        actions=columns["actions"][:, i].astype(np.int64),
        rewards=columns["rewards"][:, i].tolist(),
        terminations=columns["terminated"].tolist(),
        truncations=truncated.tolist(),
        seed=level.key[0] if level.key else None,
        options={"world": int(columns["world"][0]), "episode": int(columns["episode"][0]), "agent": i}
        | {"level": encoded([level])[0]},
    )
