"""The networks against plain ones with torch.nn.MultiheadAttention, written from the description of the authors'."""

from typing import Any

import numpy as np
import pytest

from outlast import VARIANTS, make_vec, variant
from outlast.ecs import Layout
from tests.conftest import draw_actions

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.observation_layout import ObservationLayout, earlier_scales, field_table, layout_of, scales  # noqa: E402
from outlast.training.policy import ActorCritic, MultiCategorical  # noqa: E402
from outlast.training.presets import PRESETS, preset  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
COUNTS = {"ffa_2": 22_832, "ffa_3": 23_856, "teams_2": 22_896, "teams_3": 23_920}  # of the authors' checkpoints
SIZES = (3, 3, 3, 2, 2, 2)
Arrays = dict[str, np.ndarray[Any, Any]]


def seen(name: str, chosen: str, worlds: int = 32, steps: int = 60) -> tuple[ObservationLayout, Arrays, Any, Any]:
    """Of a scenario after random steps: layout, observations (batch, ...), the same packed, scales."""
    scenario = PRESETS[chosen].scenario(variant(name).replace(agents_health=12))  # the zone kills some
    env = make_vec(scenario, worlds, seed=3)
    observations, _ = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        observations, *_ = env.step(draw_actions(env, rng))
    layout = layout_of(env)
    packed = np.zeros((worlds, env.num_agents, layout.size), np.float32)
    env.observe(out=layout.views(packed))
    flat = {key: array.reshape(-1, *array.shape[2:]).copy() for key, array in observations.items()}
    return layout, flat, torch.from_numpy(packed.reshape(-1, layout.size)), scales(layout, field_table(env.fields))


def make(chosen: str, layout: ObservationLayout, own: Any) -> Any:
    """A policy with all parameters random, so that none is without effect."""
    torch.manual_seed(1)
    policy = ActorCritic(SIZES, lambda _: 1e-3, layout=layout, preset=preset(chosen), scales=own)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.normal_(0, 0.1)
    return policy


# ---- naive forms


def embedded(extractor: Any, layout: ObservationLayout, observations: Arrays, active: Any) -> tuple[Any, Any]:
    """All rows (batch, rows, width) through a layer for each kind, and their masks."""
    rows, masks, start = [], [], 0
    for k, kind in enumerate(layout.kinds):
        weight = extractor.weight[start : start + kind.features].T
        rows.append(active(torch.nn.functional.linear(torch.tensor(observations[kind.key]), weight, extractor.bias[k])))
        masks.append(torch.tensor(observations[kind.key + "_mask"]))
        start += kind.features
    return torch.cat(rows, 1), torch.cat(masks, 1)


def own_part(extractor: Any, observations: Arrays, active: Any) -> Any:
    return active(extractor.own(torch.cat([torch.tensor(observations[key]) for key in ("own", "zone")], 1)))


def original_extractor(extractor: Any, layout: ObservationLayout, observations: Arrays) -> Any:
    """Hidden = 1; a padding row of zeros that is visible; float mask added to the logits; mean over all rows."""
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
        means.append(extractor.attention(some, some, some)[0].mean((0, 1)) if len(some[0]) else torch.zeros(32))
    return torch.cat([own_part(extractor, observations, torch.relu), torch.stack(means)], 1)


def towers(policy: Any, known: list[Any], active: Any) -> tuple[list[Any], Any]:
    """A torch distribution for each action, and values."""

    def run(tower: Any, inputs: Any) -> Any:
        return tower.last(active(tower.second(active(tower.first(inputs)))))

    logits = run(policy.actor, known[0]).split(SIZES, 1)
    return [torch.distributions.Categorical(logits=each) for each in logits], run(policy.critic, known[-1]).flatten()


def naive_outputs(policy: Any, layout: ObservationLayout, observations: Arrays) -> tuple[list[Any], Any]:
    original = policy.preset.name == "original"
    extract = original_extractor if original else paper_extractor
    known = [extract(extractor, layout, observations) for extractor in policy.extractors]
    return towers(policy, known, torch.tanh if original else torch.relu)


def measured(policy: Any, outputs: Any) -> tuple[Any, ...]:
    """Values, log probabilities, entropies, and the gradient of each parameter."""
    values, logs, entropy = outputs
    policy.zero_grad()
    (logs.mean() + values.mean()).backward()
    gradients = {name: parameter.grad for name, parameter in policy.named_parameters()}
    return values, logs, entropy, {name: torch.zeros(1) if g is None else g.clone() for name, g in gradients.items()}


@pytest.mark.parametrize("chosen", ["original", "paper"])
@pytest.mark.parametrize("name", ["ffa_2", "teams_3"])
def test_outputs_and_gradients_are_those_of_the_naive_form(name: str, chosen: str) -> None:
    layout, observations, packed, own = seen(name, chosen)
    policy = make(chosen, layout, own)
    actions = torch.stack([torch.randint(0, size, (len(packed),)) for size in SIZES], 1)
    *mine, gradients = measured(policy, policy.evaluate_actions(packed, actions))
    distributions, values = naive_outputs(policy, layout, observations)
    logs = sum(each.log_prob(action) for each, action in zip(distributions, actions.T, strict=True))
    *its, expected = measured(policy, (values, logs, sum(each.entropy() for each in distributions)))
    for one, other in zip(mine, its, strict=True):
        torch.testing.assert_close(one, other, rtol=1e-4, atol=1e-4)
    assert sum(float(gradient.abs().sum()) > 0 for gradient in expected.values()) > 15  # of about 20 tensors
    for label, gradient in expected.items():
        close = 1e-4 * float(gradient.abs().max()) + 1e-5
        torch.testing.assert_close(gradients[label].expand_as(gradient), gradient, rtol=1e-3, atol=close, msg=label)


# ---- what is visible


@pytest.mark.parametrize("chosen", PRESETS)
def test_with_nothing_visible_all_numbers_are_finite(chosen: str) -> None:
    layout, _, packed, own = seen("ffa_3", chosen)
    masks = packed[:, layout.own : layout.own + layout.rows]
    masks[::2] = 0  # half of the batch, then all of it
    for _ in range(2):
        policy = make(chosen, layout, own)
        values, logs, entropy = policy.evaluate_actions(packed, torch.zeros(len(packed), 6, dtype=torch.long))
        (values.sum() + logs.sum()).backward()
        assert all(bool(each.isfinite().all()) for each in (values, logs, entropy))
        assert all(bool(p.grad.isfinite().all()) for p in policy.parameters() if p.grad is not None)
        masks[:] = 0


@pytest.mark.parametrize(("chosen", "leaks"), [("paper", False), ("scaled", False), ("original", True)])
def test_only_the_original_knows_what_is_hidden(chosen: str, leaks: bool) -> None:
    layout, _, packed, own = seen("ffa_3", chosen)
    masks = packed[:, layout.own : layout.own + layout.rows]
    hidden = (masks == 0).repeat_interleave(layout.features, 1)
    other = packed.clone()
    other[:, layout.own + layout.rows :] += hidden * 0.5
    policy = make(chosen, layout, own)
    assert bool(torch.allclose(policy.predict_values(packed), policy.predict_values(other))) != leaks


def test_scaled_is_paper_on_scaled_inputs() -> None:
    layout, _, packed, (own, kinds) = seen("teams_3", "scaled")
    scaled = make("scaled", layout, (own, kinds))
    by_kind = torch.tensor(kinds)[torch.tensor(layout.cells())].view(-1, layout.features)
    by_cell = by_kind[layout.kind_of_row()].flatten()
    inputs = packed * torch.cat([torch.tensor(own), torch.ones(layout.rows), by_cell])
    expected = make("paper", layout, (own, kinds)).predict_values(inputs)
    torch.testing.assert_close(scaled.predict_values(packed), expected, rtol=1e-4, atol=1e-4)
    place = slice(3, layout.own)  # behind id, team, and health, which heals raise far above what it begins with
    assert float(inputs[:, place].abs().max()) < 1.5 < 10 < float(packed[:, place].abs().max())


@pytest.mark.parametrize("name", VARIANTS)
def test_scales_by_name_are_those_by_position_of_before(name: str) -> None:
    """Bit for bit, so that policies in files of before play as they did."""
    for scenario in (variant(name), variant(name).replace(room_size=31.0, agents_health=7, heals_amount=0)):
        fields = Layout(scenario.modules).fields
        layout = layout_of(make_vec(scenario, 1))
        for one, other in zip(
            scales(layout, field_table(fields)), earlier_scales(layout, scenario.numbers()), strict=True
        ):
            assert one.tobytes() == other.tobytes()
            assert one.dtype == np.float32


@pytest.mark.parametrize("chosen", PRESETS)
def test_a_world_with_nothing_to_see_will_do(chosen: str) -> None:
    layout = ObservationLayout({"own": (8,), "zone": (6,), "others": (0, 8), "others_mask": (0,)})
    policy = make(chosen, layout, scales(layout, {}))
    assert bool(policy.predict_values(torch.randn(5, layout.size)).isfinite().all())


# ---- parameters, choices, layout


@pytest.mark.parametrize(("name", "count"), COUNTS.items())
def test_the_original_has_as_many_parameters_as_the_checkpoints(name: str, count: int) -> None:
    layout, _, _, own = seen(name, "original", worlds=1, steps=0)
    assert sum(parameter.numel() for parameter in make("original", layout, own).parameters()) == count


def test_initial_weights_are_orthogonal_and_the_first_policy_is_nearly_uniform() -> None:
    layout, _, packed, own = seen("ffa_3", "original")
    policy = ActorCritic(SIZES, lambda _: 1e-3, layout=layout, preset=preset("original"), scales=own)
    start = 0
    for kind in layout.kinds:
        weight = policy.extractors[0].weight[start : start + kind.features]
        torch.testing.assert_close(weight @ weight.T, 2 * torch.eye(kind.features), atol=1e-5, rtol=0)
        start += kind.features
    entropy = policy.evaluate_actions(packed, torch.zeros(len(packed), 6, dtype=torch.long))[2]
    assert float(entropy.min()) > np.log(np.prod(SIZES)) - 0.01


def test_choices_are_drawn_as_often_as_they_are_likely() -> None:
    choices, head = MultiCategorical(SIZES), torch.nn.Linear(4, sum(SIZES))
    logs = choices.log_probabilities(torch.randn(1, 4), head)
    drawn = choices.draw(logs.expand(20_000, -1, -1), torch.Generator().manual_seed(0))
    for k, size in enumerate(SIZES):
        share = torch.bincount(drawn[:, k], minlength=size) / len(drawn)
        assert len(share) == size
        torch.testing.assert_close(share, logs[0, k, :size].exp(), atol=0.015, rtol=0)


def test_the_views_of_a_packed_array_are_the_observations() -> None:
    layout, observations, packed, _ = seen("teams_3", "original")
    views = layout.views(packed.numpy()[:, None])
    assert views.keys() == observations.keys()
    assert all(np.array_equal(views[key][:, 0], values) for key, values in observations.items())
    assert packed.shape[1] == layout.size == 15 + 36 + 36 * 11


def test_an_unknown_preset_is_refused() -> None:
    with pytest.raises(ValueError, match="no preset 'big'; known: original, paper, scaled"):
        preset("big")
