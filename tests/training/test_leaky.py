"""Attention of preset original against torch.nn.MultiheadAttention, in float64, whatever is visible."""

from typing import Any

import pytest

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from dataclasses import replace  # noqa: E402

from outlast.training.base.observation_layout import ObservationLayout  # noqa: E402
from outlast.training.base.presets import PRESETS  # noqa: E402
from outlast.training.policies.networks import Extractor  # noqa: E402
from outlast.training.policies.rows import PaddedRows  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
SHAPES = {"own": (8,), "boxes": (5, 7), "box_slot": (1, 3), "heals": (6, 2)}
BATCH = 40
VISIBLE = {  # how many rows each sample sees, of twelve
    "nothing": [0] * BATCH,
    "one row": [1] * BATCH,
    "all rows": [12] * BATCH,
    "from none to all": [k % 13 for k in range(BATCH)],
    "few, most often none": [9 if k == 3 else 2 if k % 5 == 0 else 0 for k in range(BATCH)],
}


def layout_of(shapes: dict[str, tuple[int, ...]]) -> ObservationLayout:
    masks = {key + "_mask": shape[:1] for key, shape in shapes.items() if len(shape) == 2}
    return ObservationLayout({**shapes, **masks})


def make(layout: ObservationLayout) -> Any:
    """An extractor in float64 with all parameters random, so that none is without effect."""
    torch.manual_seed(1)
    extractor = Extractor(layout, PRESETS["original"], ([], [])).double()
    with torch.no_grad():
        for parameter in extractor.parameters():
            parameter.normal_(0, 0.3)
    return extractor


def observed(layout: ObservationLayout, visible: list[int]) -> PaddedRows:
    """Random observations with so many visible rows a sample; a third of the rows that are hidden are absent: zeros."""
    torch.manual_seed(2)
    padded = PaddedRows(torch.zeros(len(visible), layout.size, dtype=torch.float64), layout)
    padded.own.normal_()
    for sample, count in enumerate(visible):
        padded.seen[sample, torch.randperm(layout.rows)[:count]] = 1
    there = (padded.seen > 0) | (torch.rand(padded.seen.shape) < 0.67)
    start = 0
    for kind in layout.kinds:
        some = slice(start, start + kind.rows)
        padded.rows[:, some, : kind.features] = there[:, some, None] * torch.randn(
            len(visible), kind.rows, kind.features, dtype=torch.float64
        )
        start += kind.rows
    return padded


def naive(extractor: Any, padded: PaddedRows) -> Any:
    """Row by row through the layer of its kind; a padding row; the mask as a float, 1 where hidden; the mean."""
    layout, embedded, row, first = padded.layout, [], 0, 0
    for kind, bias in zip(layout.kinds, extractor.bias, strict=True):
        weight = extractor.weight[first : first + kind.features]
        for _ in range(kind.rows):
            embedded.append(torch.tanh(padded.rows[:, row, : kind.features] @ weight + bias))
            row += 1
        first += kind.features
    rows = torch.stack([*embedded, torch.zeros(len(padded), 32, dtype=torch.float64)], 1)
    hidden = torch.cat([1 - padded.seen, torch.zeros(len(padded), 1, dtype=torch.float64)], 1)
    attended, _ = extractor.attention(rows, rows, rows, key_padding_mask=hidden, need_weights=False)
    entities = attended.masked_fill(hidden[:, :, None] == 1, 0).mean(1)
    return torch.cat([torch.tanh(extractor.own(padded.own)), entities], 1)


def measured(extractor: Any, features: Any) -> tuple[Any, dict[str, Any]]:
    """Features, and gradients of all parameters in random directions of the features."""
    torch.manual_seed(3)
    extractor.zero_grad()
    (features * torch.randn_like(features)).sum().backward()
    return features, {name: parameter.grad.clone() for name, parameter in extractor.named_parameters()}


@pytest.mark.parametrize("visible", VISIBLE.values(), ids=VISIBLE)
def test_features_and_gradients_are_those_of_the_naive_form(visible: list[int]) -> None:
    layout = layout_of(SHAPES)
    extractor, padded = make(layout), observed(layout, visible)
    features, gradients = measured(extractor, extractor(padded))
    expected, others = measured(extractor, naive(extractor, padded))
    torch.testing.assert_close(features, expected, rtol=1e-10, atol=1e-12)
    assert gradients.keys() == others.keys()
    for name, gradient in others.items():
        torch.testing.assert_close(gradients[name], gradient, rtol=1e-9, atol=1e-10, msg=name)
    assert all(bool(gradient.abs().max() > 1e-6) for gradient in gradients.values())


def test_in_float32_it_is_as_near_to_the_truth_as_the_naive_form() -> None:
    layout = layout_of(SHAPES)
    extractor, padded = make(layout), observed(layout, VISIBLE["from none to all"])
    with torch.inference_mode():
        expected = extractor(padded)
        found = extractor.float()(PaddedRows(padded.packed.float(), layout))
    torch.testing.assert_close(found.double(), expected, rtol=0, atol=1e-6 * float(expected.abs().max()))


def test_samples_do_not_depend_on_each_other() -> None:
    layout = layout_of(SHAPES)
    extractor, padded = make(layout), observed(layout, VISIBLE["from none to all"])
    alone = [extractor(padded.select(torch.tensor([sample]))) for sample in range(BATCH)]
    torch.testing.assert_close(extractor(padded), torch.cat(alone), rtol=1e-10, atol=1e-12)
    assert extractor(padded.select(torch.zeros(0, dtype=torch.long))).shape == (0, 64)


def test_a_world_with_nothing_to_see_will_do() -> None:
    layout = layout_of({"own": (8,), "others": (0, 8)})
    extractor, padded = make(layout), observed(layout, [0] * 5)
    features, gradients = measured(extractor, extractor(padded))
    torch.testing.assert_close(features, naive(extractor, padded), rtol=1e-10, atol=1e-12)
    assert all(bool(gradient.isfinite().all()) for gradient in gradients.values())


def test_gradients_by_observations_are_refused() -> None:
    layout = layout_of(SHAPES)
    with pytest.raises(ValueError, match="gradients by its parameters only"):
        make(layout)(PaddedRows(torch.zeros(2, layout.size, dtype=torch.float64, requires_grad=True), layout))


@pytest.mark.parametrize("change", [{"activation": "relu"}, {"padded": False}])
def test_a_leaky_preset_with_another_activation_or_without_padding_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="a leaky one has padding and tanh"):
        Extractor(layout_of(SHAPES), replace(PRESETS["original"], **change), ([], []))
