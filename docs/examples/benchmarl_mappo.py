"""MAPPO of BenchMARL in outlast's worlds: train, and print by how many standard errors returns have risen.

python benchmarl_mappo.py --frames 2000000 --out runs/mappo
"""

import json
from argparse import ArgumentParser
from pathlib import Path
from typing import Any

import numpy as np
from benchmarl.algorithms import IppoConfig, MaddpgConfig, MappoConfig, MasacConfig, QmixConfig, VdnConfig
from benchmarl.environments.common import TaskClass
from benchmarl.experiment import Experiment, ExperimentConfig
from benchmarl.models.mlp import MlpConfig
from torch import nn

from outlast.envs.adapters.benchmarl import task

CONTINUOUS = {"maddpg": MaddpgConfig, "masac": MasacConfig}  # algorithms for continuous actions
ALGORITHMS = {"mappo": MappoConfig, "ippo": IppoConfig, "qmix": QmixConfig, "vdn": VdnConfig, **CONTINUOUS}
WORLDS, BATCH = 64, 8192  # worlds that are stepped together; frames, of all of them, between two updates


def experiment(own: TaskClass, algorithm: str, frames: int, out: Path, seed: int = 0, **changes: Any) -> Experiment:
    """What BenchMARL is to do. A frame is a tick of one world. changes: Of its ExperimentConfig."""
    config = ExperimentConfig.get_from_yaml()
    config.max_n_frames, config.save_folder, config.loggers = frames, str(out), ["csv"]
    config.lr, config.prefer_continuous_actions = 1e-3, False
    config.on_policy_n_envs_per_worker = config.off_policy_n_envs_per_worker = WORLDS
    config.on_policy_collected_frames_per_batch = config.off_policy_collected_frames_per_batch = BATCH
    config.on_policy_n_minibatch_iters, config.on_policy_minibatch_size = 4, 1024
    config.off_policy_n_optimizer_steps, config.off_policy_train_batch_size = 100, 512
    config.evaluation_interval, config.evaluation_episodes = 10 * BATCH, 64
    # Evaluations draw actions: an untrained agent that takes the likeliest ones stands still, and so lives long.
    config.evaluation_deterministic_actions = False
    for key, value in changes.items():
        setattr(config, key, value)
    model = MlpConfig(num_cells=[128, 128], layer_class=nn.Linear, activation_class=nn.Tanh)
    return Experiment(
        task=own,
        algorithm_config=ALGORITHMS[algorithm].get_from_yaml(),
        model_config=model,
        critic_model_config=model,
        seed=seed,
        config=config,
    )


def returns(folder: Path) -> tuple[np.ndarray[Any, Any], list[list[float]]]:
    """Frames before each evaluation, and the returns of its episodes, from BenchMARL's file for marl-eval."""
    (file,) = folder.rglob("*.json")
    (run,) = (
        run
        for tasks in json.loads(file.read_text()).values()
        for own in tasks.values()
        for each in own.values()
        for run in each.values()
    )
    steps = [value for key, value in run.items() if key.startswith("step_")]
    return np.array([step["step_count"] for step in steps]), [step["return"] for step in steps]


def rise(values: list[list[float]]) -> float:
    """Standard errors, over episodes, between the last fifth of the evaluations and the first one."""
    part = max(1, len(values) // 5)
    first, last = np.concatenate(values[:part]), np.concatenate(values[-part:])
    error = np.sqrt(first.var(ddof=1) / len(first) + last.var(ddof=1) / len(last))
    return float((last.mean() - first.mean()) / error)


def draw(frames: np.ndarray[Any, Any], values: list[list[float]], path: Path) -> None:
    """Mean return by frames, with an error bar of one standard error."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 3.2), layout="constrained")
    errors = [np.std(each, ddof=1) / np.sqrt(len(each)) for each in values]
    axes.errorbar(frames / 1e6, [np.mean(each) for each in values], errors, marker=".", capsize=2)
    axes.set(xlabel="million frames (ticks of a world)", ylabel="return of an agent")
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=100)


def main() -> None:
    """Train, and print."""
    parser = ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", default="teams_2", help="what is played (default teams_2)")
    parser.add_argument("--algorithm", default="mappo", choices=ALGORITHMS, help="default mappo")
    parser.add_argument("--frames", type=int, default=2_000_000, help="ticks of a world, over all worlds (default 2e6)")
    parser.add_argument("--seed", type=int, default=0, help="of training (default 0)")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/mappo"), help="new folder of the run (default runs/mappo)"
    )
    parser.add_argument("--show", action="store_true", help="train nothing, and print the results of the run in --out")
    parser.add_argument("--figure", type=Path, help="also draw the returns into this PNG")
    options = parser.parse_args()
    if not options.show:
        options.out.mkdir(parents=True)
        actions = "continuous" if options.algorithm in CONTINUOUS else "joint"
        own = task(options.scenario, max_episode_steps=600, actions=actions)
        experiment(own, options.algorithm, options.frames, options.out, options.seed).run()
    frames, values = returns(options.out)
    if options.figure:
        draw(frames, values, options.figure)
    print(
        f"{frames[-1]:,} frames: return {np.mean(values[0]):.1f} at first, {np.mean(values[-1]):.1f} at the end; "
        f"from the first fifth to the last one it has risen by {rise(values):.1f} standard errors"
    )


if __name__ == "__main__":
    main()
