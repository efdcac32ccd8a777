"""The networks and what they are given, against plain forms with torch.nn.MultiheadAttention, in float64.

Plain forms are written from the description of the authors' networks.
"""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from outlast import make_vec, variant
from outlast.envs.rollout.policies import scripted_policy
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.observation_layout import MASK, ObservationLayout, field_table, layout_of, scales
from outlast.training.base.policy_file import RUN_JSON
from outlast.training.base.presets import PRESETS, Form, preset
from outlast.training.policies import compiled_networks
from outlast.training.policies.checkpoint import write_checkpoint
from outlast.training.policies.player import Player
from outlast.training.policies.policy import ActorCritic, Extractor, MultiCategorical
from outlast.training.policies.rows import Packer, PaddedRows, concatenated
from outlast.training.ppo.trainer import Trainer, capture
from tests.conftest import compiled_only, draw_actions
from tests.helpers.trainers import doubled

COUNTS = {"ffa_2": 22_832, "ffa_3": 23_856, "teams_2": 22_896, "teams_3": 23_920}  # of the authors' checkpoints
SIZES = (3, 3, 3, 2, 2, 2)
Arrays = dict[str, np.ndarray[Any, Any]]


def seen(name: str, chosen: str, worlds: int = 32, steps: int = 60) -> tuple[ObservationLayout, Arrays, Any]:
    """Of a scenario after random steps: layout, observations (batch, ...), scales.

    The first agents see nothing, those behind them one entity, those behind these all that there are.
    """
    scenario = PRESETS[chosen].scenario(variant(name).replace(agents_health=12))  # the zone kills some
    env = make_vec(scenario, worlds, seed=3)
    observations, _ = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        observations, *_ = env.step(draw_actions(env, rng))
    layout = layout_of(env)
    flat = {key: array.reshape(-1, *array.shape[2:]).copy() for key, array in observations.items()}
    for k, kind in enumerate(layout.kinds):
        mask = flat[kind.key + MASK]
        mask[:4], mask[2:4, :1], mask[4:8] = 0, k == 0, 1
        flat[kind.key][:8] = rng.normal(0, 3, flat[kind.key][:8].shape)
    return layout, flat, scales(layout, field_table(env.fields))


def packed(chosen: str, layout: ObservationLayout, observations: Arrays) -> Any:
    return doubled(Packer(layout, Form(preset(chosen).leaky, False))(observations))


def make(chosen: str, layout: ObservationLayout, own: Any) -> Any:
    """A policy with all parameters random, so that none is without effect, in float64."""
    torch.manual_seed(1)
    policy = ActorCritic(SIZES, layout=layout, preset=preset(chosen), scales=own)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.normal_(0, 0.1)
    return policy.double()


def evaluated(policy: Any, inputs: Any, actions: Any) -> tuple[Any, Any, Any]:
    logs, values, _ = policy(inputs)
    return values, policy.choices.of(actions, logs), policy.choices.entropy(logs)


def embedded(extractor: Any, layout: ObservationLayout, observations: Arrays, active: Any) -> tuple[Any, Any]:
    """All rows (batch, rows, width) through a layer for each kind, and their masks."""
    rows, masks, start = [], [], 0
    for k, kind in enumerate(layout.kinds):
        numbers = slice(start, start + kind.features)
        inputs = torch.tensor(observations[kind.key]).double() * extractor.scale[numbers, 0]
        rows.append(active(torch.nn.functional.linear(inputs, extractor.weight[numbers].T, extractor.bias[k])))
        masks.append(torch.tensor(observations[kind.key + MASK]).double())
        start += kind.features
    return torch.cat(rows, 1), torch.cat(masks, 1)


def own_part(extractor: Any, observations: Arrays, active: Any) -> Any:
    inputs = torch.cat([torch.tensor(observations[key]).double() for key in ("own", "zone")], 1)
    return active(extractor.own(inputs * extractor.own_scale))


def original_extractor(extractor: Any, layout: ObservationLayout, observations: Arrays) -> Any:
    """Have hidden = 1, a visible padding row of zeros, a float mask added to the logits, and a mean over all rows."""
    rows, visible = embedded(extractor, layout, observations, torch.tanh)
    batch = len(rows)
    rows = torch.cat([rows, torch.zeros(batch, 1, 32)], 1)
    hidden = torch.cat([1 - visible, torch.zeros(batch, 1)], 1)
    attended, _ = extractor.attention(rows, rows, rows, key_padding_mask=hidden, need_weights=False)
    attended = attended.masked_fill(hidden[:, :, None] == 1, 0)
    return torch.cat([own_part(extractor, observations, torch.tanh), attended.mean(1)], 1)


def paper_extractor(extractor: Any, layout: ObservationLayout, observations: Arrays) -> Any:
    """Sample by sample: only visible rows exist, and are averaged."""
    rows, visible = embedded(extractor, layout, observations, torch.relu)
    means = []
    for sample, mask in zip(rows, visible, strict=True):
        some = sample[mask > 0][None]
        none = torch.zeros(32, dtype=torch.float64)
        means.append(extractor.attention(some, some, some)[0].mean((0, 1)) if len(some[0]) else none)
    return torch.cat([own_part(extractor, observations, torch.relu), torch.stack(means)], 1)


def towers(policy: Any, known: list[Any], active: Any) -> tuple[list[Any], Any]:
    def run(tower: Any, inputs: Any) -> Any:
        return tower.last(active(tower.second(active(tower.first(inputs)))))

    logits = run(policy.actor, known[0]).split(SIZES, 1)
    return [torch.distributions.Categorical(logits=each) for each in logits], run(policy.critic, known[-1]).flatten()


def naive_outputs(policy: Any, layout: ObservationLayout, observations: Arrays, actions: Any) -> tuple[Any, Any, Any]:
    """Values, log probabilities of the actions, entropies."""
    extract = original_extractor if policy.preset.leaky else paper_extractor
    known = [extract(extractor, layout, observations) for extractor in policy.extractors]
    each, values = towers(policy, known, torch.tanh if policy.preset.leaky else torch.relu)
    logs = sum(one.log_prob(action) for one, action in zip(each, actions.T, strict=True))
    return values, logs, sum(one.entropy() for one in each)


def gradients(policy: Any, outputs: Any) -> dict[str, Any]:
    policy.zero_grad()
    values, logs, entropy = outputs
    (logs.mean() + values.square().mean() + 0.3 * entropy.mean()).backward()
    found = {name: parameter.grad for name, parameter in policy.named_parameters()}
    return {name: torch.zeros(1) if each is None else each.clone() for name, each in found.items()}


@pytest.mark.parametrize("chosen", PRESETS)
@pytest.mark.parametrize("name", ["ffa_2", "teams_3"])
def test_outputs_and_gradients_are_those_of_the_naive_form(name: str, chosen: str) -> None:
    layout, observations, own = seen(name, chosen)
    policy, inputs = make(chosen, layout, own), packed(chosen, layout, observations)
    actions = torch.stack([torch.randint(0, size, (len(inputs),)) for size in SIZES], 1)
    mine, its = evaluated(policy, inputs, actions), naive_outputs(policy, layout, observations, actions)
    for one, other in zip(mine, its, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-9)
    found, expected = gradients(policy, mine), gradients(policy, its)
    assert sum(float(gradient.abs().sum()) > 0 for gradient in expected.values()) > 15  # of about 20 tensors
    for label, gradient in expected.items():
        close = 1e-6 * float(gradient.abs().max()) + 1e-12
        one = found[label].expand_as(gradient).to(gradient)
        torch.testing.assert_close(one, gradient, rtol=0, atol=close, msg=label)


def assert_same(one: Any, other: Any) -> None:
    parts = ("packed",) if isinstance(one, PaddedRows) else ("own", "entities", "count")
    assert type(one) is type(other)
    assert all(torch.equal(getattr(one, part), getattr(other, part)) for part in parts)


@pytest.mark.parametrize("leaky", [False, True])
def test_rows_of_some_agents_and_of_several_batches(leaky: bool) -> None:
    layout, observations, _ = seen("teams_3", "original")
    pack = Packer(layout, Form(leaky, False))
    whole = pack(observations)
    for index in ([0, 1], [5], [7, 3, 3, 0, 60], [0, 0], list(range(len(whole)))[::-1], []):
        some = whole.select(torch.tensor(index, dtype=torch.long))
        assert len(some) == len(index)
        assert_same(some, pack({key: values[index] for key, values in observations.items()}))
    assert_same(concatenated([whole.select(torch.arange(k, k + 32)) for k in range(0, len(whole), 32)]), whole)
    by_world = pack({key: values.reshape(-1, 4, *values.shape[1:]) for key, values in observations.items()})
    assert_same(by_world, whole)


@pytest.mark.parametrize("chosen", PRESETS)
def test_with_nothing_visible_all_numbers_are_finite(chosen: str) -> None:
    """In a batch that sees nothing, and in a game with nothing to see."""
    layout, observations, own = seen("ffa_3", chosen)
    for kind in layout.kinds:
        observations[kind.key + MASK][:] = 0
    bare = ObservationLayout({"own": (8,), "zone": (6,), "others": (0, 8), "others_mask": (0,)})
    empty = {key: np.ones((5, *shape), np.float32) for key, shape in bare.shapes.items()}
    for known, given, by in ((layout, observations, own), (bare, empty, scales(bare, {}))):
        policy, actions = make(chosen, known, by), torch.zeros(len(given["own"]), 6, dtype=torch.long)
        found = evaluated(policy, packed(chosen, known, given), actions)
        policy.zero_grad()
        sum(each.sum() for each in found).backward()
        assert all(bool(p.grad.isfinite().all()) for p in policy.parameters() if p.grad is not None)
        torch.testing.assert_close(found, naive_outputs(policy, known, given, actions), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(("name", "count"), COUNTS.items())
def test_the_original_has_as_many_parameters_as_the_checkpoints(name: str, count: int) -> None:
    layout, _, own = seen(name, "original", worlds=1, steps=0)
    assert sum(parameter.numel() for parameter in make("original", layout, own).parameters()) == count


def test_initial_weights_are_orthogonal_and_the_first_policy_is_nearly_uniform() -> None:
    layout, observations, own = seen("ffa_3", "original")
    policy = ActorCritic(SIZES, layout=layout, preset=preset("original"), scales=own).double()
    start = 0
    for kind in layout.kinds:
        weight = policy.extractors[0].weight[start : start + kind.features]
        torch.testing.assert_close(weight @ weight.T, 2 * torch.eye(kind.features).double(), atol=1e-5, rtol=0)
        start += kind.features
    with torch.no_grad():
        logs, *_ = policy(packed("original", layout, observations))
    assert float(policy.choices.entropy(logs).min()) > np.log(np.prod(SIZES)) - 0.01


@pytest.mark.parametrize("sizes", [SIZES, (2, 2), (1, 5, 2), (9, 3)])
def test_choices_are_drawn_as_often_as_they_are_likely(sizes: tuple[int, ...]) -> None:
    choices, head = MultiCategorical(sizes), torch.nn.Linear(4, sum(sizes))
    logs = choices.log_probabilities(torch.randn(1, 4), head)
    drawn = choices.draw(logs.expand(-1, -1, 20_000), torch.rand(20_000, len(sizes)))
    for k, size in enumerate(sizes):
        share = torch.bincount(drawn[:, k], minlength=size) / len(drawn)
        assert len(share) == size
        torch.testing.assert_close(share, logs[:size, k, 0].exp(), atol=0.015, rtol=0)
    for a, b in itertools.combinations(range(len(sizes)), 2):  # independently of each other
        together = torch.bincount(drawn[:, a] * sizes[b] + drawn[:, b], minlength=sizes[a] * sizes[b]) / len(drawn)
        expected = logs[: sizes[a], a].exp() * logs[: sizes[b], b, 0].exp()
        torch.testing.assert_close(together, expected.flatten(), atol=0.015, rtol=0)


def test_no_value_is_drawn_that_an_action_has_not() -> None:
    """Where the sum of its probabilities is rounded to less than the number that is drawn."""
    choices = MultiCategorical((2, 3))
    logs = torch.tensor([[0.5, 0.49999, 0.0], [0.3, 0.3, 0.39999]]).log().T[:, :, None]
    assert choices.draw(logs, torch.full((1, 2), 1 - 2**-24)).tolist() == [[1, 2]]
    assert choices.draw(torch.tensor([[0.0, 0.4, 0.6]] * 2).log().T[:, :, None], torch.zeros(1, 2)).tolist() == [[1, 1]]


def test_what_no_extractor_can_be_is_refused() -> None:
    layout, observations, own = seen("ffa_2", "original", worlds=1, steps=0)
    with pytest.raises(ValueError, match="unknown preset 'big'; known: original, paper, scaled"):
        preset("big")
    with pytest.raises(ValueError, match="with leaky, the activation must be tanh"):
        Extractor(layout, replace(PRESETS["original"], activation="relu"), own)
    inputs = packed("original", layout, observations)
    inputs.packed.requires_grad_()
    with pytest.raises(ValueError, match="gradients by its parameters only"):
        make("original", layout, own)(inputs)


@compiled_only
@pytest.mark.parametrize("agents", [0, 2, 130], ids=["no agent", "no row", "many"])
@pytest.mark.parametrize("function", ["can_attend", "possible"], ids=["attention", "networks"])
def test_networks_in_compiled_code_are_those_of_pytorch(function: str, agents: int, monkeypatch) -> None:
    """And so are their gradients, of several blocks of agents; or only attention is compiled."""
    layout, observations, own = seen("teams_3", "fast")
    rows = Packer(layout, Form(False, False))(observations).select(torch.arange(agents) % 128)
    policy, found = make("fast", layout, own).float(), []
    if function == "can_attend":
        monkeypatch.setattr(compiled_networks, "possible", lambda *given: False)
    for possible in (getattr(compiled_networks, function), lambda *given: False):
        monkeypatch.setattr(compiled_networks, function, possible)
        logs, values, _ = policy(rows)
        loss = (logs.clamp(min=-9) * torch.arange(6.0)[:, None]).sum() + (values * torch.arange(1.0, 1 + agents)).sum()
        slopes = torch.autograd.grad(loss, list(policy.parameters()))
        found.append([logs.detach(), values.detach(), *(slope / slope.abs().max().clamp(min=1) for slope in slopes)])
    assert agents < 130 or not all(map(torch.equal, *found))  # or both would be one form
    for one, other in zip(*found, strict=True):
        torch.testing.assert_close(one, other, rtol=2e-5, atol=2e-5)


@compiled_only
def test_actions_that_compiled_code_chooses_are_those_of_pytorch() -> None:
    """Some are not drawn: these are `noop`, and count for nothing in the log-probabilities."""
    layout, observations, own = seen("teams_3", "fast")
    rows, rng = Packer(layout, Form(False, False))(observations), np.random.default_rng(0)
    policy, noop = make("fast", layout, own).float(), torch.tensor([1, 1, 1, 0, 0, 0])
    uniform, idle = rng.random((128, 6), np.float32), rng.random((128, 6)) < 0.3
    logs, values, _ = policy(rows)
    drawn = policy.choices.draw(logs, torch.from_numpy(uniform))
    for masked in (False, True):
        free = torch.from_numpy(~idle) if masked else None
        expected = torch.where(free, drawn, noop) if masked else drawn
        found = compiled_networks.Acting(policy)(rows, uniform, idle if masked else None, noop.numpy())
        assert np.array_equal(found[0], expected)
        assert len(np.unique(found[0][:, 0])) == 3
        torch.testing.assert_close(found[1], policy.choices.of(expected, logs, free), rtol=1e-5, atol=1e-6)
        assert torch.equal(found[2], values)


def turned(row: Any, fields: Any, me: Any, own: bool) -> Any:
    """One row in the frame of an agent that is at (x, y), moves by (vx, vy) and looks along angle."""
    x, y, vx, vy, angle = me
    found = row.copy()

    def put(first: str, second: str, ahead: float, left: float) -> None:
        found[fields[first].start] = math.cos(angle) * ahead + math.sin(angle) * left
        found[fields[second].start] = math.cos(angle) * left - math.sin(angle) * ahead

    def value(name: str) -> float:
        return float(row[fields[name].start])

    for one, two in (("x", "y"), ("next_x", "next_y")):
        if one in fields:
            put(one, two, -x if own else value(one) - x, -y if own else value(two) - y)
    if "vx" in fields:
        put("vx", "vy", value("vx") - vx * (not own), value("vy") - vy * (not own))
    if "angle" in fields:
        angle_there = value("angle") - angle * (not own)
        found[fields["angle"].start] = math.atan2(math.sin(angle_there), math.cos(angle_there))
    return found


@pytest.mark.parametrize("name", ["ffa_2", "teams_3", "ffa_4"])
def test_rows_in_the_frame_of_the_agent_are_those_of_the_naive_form(name: str) -> None:
    env = make_vec(name, 4, seed=0)
    env.reset(seed=0)
    policy = scripted_policy(env)
    for _ in range(60):
        env.step(policy(env.observe()))
    seen, layout = env.observe(), layout_of(env)
    found = Packer(layout, Form(False, True))(seen)
    starts = {key: min(columns.values()) for key, columns in layout.field_columns().items()}
    rows = iter(found.entities.numpy())

    def close(row: Any, key: str, of: Any, me: list[float]) -> None:
        expected = turned(of, env.fields[key], me, key == "own")
        np.testing.assert_allclose(row[starts[key] :][: len(expected)], expected, rtol=1e-5, atol=2e-5)

    for agent, (w, a) in enumerate(np.ndindex(4, env.num_agents)):
        own = seen["own"][w, a]
        me = [float(own[env.fields["own"][key].start]) for key in ("x", "y", "vx", "vy", "angle")]
        for key in layout.alone:
            close(found.own[agent].numpy(), key, seen[key][w, a].ravel(), me)
        for kind in layout.kinds:
            for k in np.flatnonzero(seen[kind.key + MASK][w, a]):
                close(next(rows), kind.key, seen[kind.key][w, a, k], me)
    assert next(rows, None) is None


def test_a_policy_without_the_fields_that_turn_is_refused(tmp_path: Path) -> None:
    trainer = Trainer(TrainingConfig(variant("ffa_2"), "fast", worlds=1, rollout=16))
    files = capture(trainer, trainer.config.header())
    header = json.loads(files[RUN_JSON])
    header["fields"]["own"]["heading"] = header["fields"]["own"].pop("angle")
    write_checkpoint(tmp_path / "broken.zip", files | {RUN_JSON: json.dumps(header).encode()})
    with pytest.raises(TrainingError, match="preset fast needs the fields x, y, vx, vy, angle of 'own'"):
        Player(tmp_path / "broken.zip")


def test_lists_of_rows_may_have_another_type_and_lie_apart() -> None:
    """What is copied for the kernel must be there until it has been read."""
    env = make_vec("teams_3", 64, seed=0, observations="rows")
    lists, _ = env.reset()
    pack = Packer(layout_of(make_vec("teams_3", 1)), Form(False, True))
    rows = {key: value for key, value in lists.items() if value.ndim == 2}
    apart = {key: np.repeat(value.astype(np.float64), 2, 1)[:, ::2] for key, value in rows.items()}
    assert_same(pack(lists | apart), pack(lists))
