"""The networks of preset `fast` in two compiled functions, for the CPU: outputs, and gradients of all weights.

ActorCritic is the reference in PyTorch. It also runs on a GPU, with a memory, with a critic of the state and with other
presets. It processes a complete batch with each of about a hundred operations. Here, a block of agents goes through all
layers while its numbers are in the cache, and other threads of Python run at the same time.

For other presets, attention alone is compiled: an agent sees one or two rows, but PyTorch needs lists of all pairs of
rows, and spends most of its time on lists and calls.
"""

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor

from outlast.ecs.kernels.jit import compiled, kernel, loader, storer
from outlast.ecs.kernels.vectors import (
    BYTES,
    HEAD,
    exponential,
    gated,
    head_sums,
    larger,
    load,
    product,
    quotient,
    repeated,
    store,
)
from outlast.envs.core.visible_rows import called

from ..base.observation_layout import ObservationLayout
from ..base.presets import Preset
from .rows import Rows
from .torch_settings import FLOAT, INDEX

Array = np.ndarray[Any, Any]
BLOCK = 64  # agents that go through all layers together
LOWEST: Any = np.float32(-np.inf)
VECTOR = 16  # numbers of a vector; results of products are padded to full vectors
TOWER = "first", "second", "last"
LAYERS, SEEING = 10, 3  # in order; the first ones come before attention
# Memory that layers read and write: observations, intermediate records of each agent and entity, and results.
OWN, ENTITIES, AGENTS, ROWS, LOGITS, VALUES = range(6)
# The fields of a layer, int64: places are a base, an offset and the distance from one record to the next, in bytes.
X, X_OFFSET, X_STRIDE, Y, Y_OFFSET, Y_STRIDE, INPUTS, OUTPUTS, RELU, ADDS, BY_OUTPUT, BY_INPUT, PACKED, FIELDS = range(
    14
)
# Arguments of a call, int64, most of them addresses: the bases, those of slopes, weights and biases of the layers, ...
SLOPES, WEIGHTS, BIASES = 6, 12, 12 + LAYERS
ZEROS, ONE = SLOPES + OWN, SLOPES + ENTITIES  # instead of unused slopes: zeros, and a number 1
EXPONENTIALS = SLOPES + LOGITS  # instead of slopes: memory for those of an agent
LAYER, COUNT, AGENT_COUNT, WIDTH, WEIGHT_MEMORY, LIKELY, FOUND, GRADIENTS = range(BIASES + LAYERS, BIASES + LAYERS + 8)
word, read, read_flag = loader("int64"), loader("float32"), loader("uint8")
write, write_word = storer("float32"), storer("int64")


@kernel
def attend(
    rows: int, stride: int, count: int, agents: int, width: int, likely: int, shares: int, share_stride: int,
    means: int, mean_stride: int,
) -> int:  # fmt: skip
    """Average the outputs of attention over the rows of each agent. Arguments are addresses, or bytes between rows.

    A head has HEAD numbers. A value of a head is written HEAD times, so that vectors need not be rearranged.

    rows: float32, query, key and value of each row, `width` numbers each (a multiple of 16), agent after agent. count:
    int64 (agents,), rows of each agent. Written are likely: float32 (pairs, width), the attention of each row to each
    row of its agent; shares: float32 (rows, width), the means of these over the rows that attend; and means: float32
    (agents, width), the sums of the values by these shares, 0 for an agent without rows.
    """
    width, scale = 4 * width, np.float32(1 / math.sqrt(HEAD))
    zero, one = repeated(np.float32(0)), repeated(np.float32(1))
    for i in range(agents):
        seen = word(count + 8 * i)
        each = repeated(np.float32(1) / np.float32(seen))
        for h in range(0, width, BYTES):
            mean = zero
            if seen == 1:
                store(likely + h, one)
                store(shares + h, one)
                mean = load(rows + 2 * width + h)
            elif seen > 1:
                for k in range(seen):
                    store(shares + k * share_stride + h, zero)
                for q in range(seen):
                    pairs, highest, total = likely + q * seen * width + h, repeated(np.float32(-math.inf)), zero
                    query = load(rows + q * stride + h) * scale
                    for k in range(seen):
                        logit = head_sums(query * load(rows + k * stride + width + h))
                        store(pairs + k * width, logit)
                        highest = larger(highest, logit)
                    for k in range(seen):
                        weight = exponential(load(pairs + k * width) - highest)
                        store(pairs + k * width, weight)
                        total = total + weight
                    factor = quotient(one, total)
                    for k in range(seen):
                        weight, share = load(pairs + k * width) * factor, shares + k * share_stride + h
                        store(pairs + k * width, weight)
                        store(share, load(share) + weight)
                for k in range(seen):
                    share = load(shares + k * share_stride + h) * each
                    store(shares + k * share_stride + h, share)
                    mean = mean + share * load(rows + k * stride + 2 * width + h)
            store(means + h, mean)
        rows, shares, likely = rows + seen * stride, shares + seen * share_stride, likely + seen * seen * width
        means += mean_stride
    return 0


@kernel
def differentiate(
    rows: int, stride: int, count: int, agents: int, width: int, likely: int, shares: int, share_stride: int,
    slopes: int, slope_stride: int, found: int,
) -> int:  # fmt: skip
    """Compute the gradients of `attend`, whose arguments and results come first; `shares` is overwritten.

    shares: Becomes the gradients of these shares. slopes: float32 (agents, width), gradients of the means.
    slope_stride: Bytes from one row of `slopes` to the next. found: float32, written: gradients of rows, at `stride`.
    """
    width, scale, zero = 4 * width, np.float32(1 / math.sqrt(HEAD)), repeated(np.float32(0))
    for i in range(agents):
        seen = word(count + 8 * i)
        each = np.float32(1) / np.float32(seen)
        for h in range(0, width, BYTES):
            slope = load(slopes + h)
            for k in range(seen):
                share, row, to = shares + k * share_stride + h, rows + k * stride + h, found + k * stride + h
                store(to, zero)
                store(to + width, zero)
                store(to + 2 * width, load(share) * slope)
                store(share, head_sums(load(row + 2 * width) * slope) * each)
            for q in range(seen if seen > 1 else 0):  # for one row, the share is 1 for any query
                pairs, mean, query, moved = likely + q * seen * width + h, zero, load(rows + q * stride + h), zero
                for k in range(seen):
                    mean = mean + load(pairs + k * width) * load(shares + k * share_stride + h)
                for k in range(seen):
                    change = load(pairs + k * width) * (load(shares + k * share_stride + h) - mean) * scale
                    key, to = rows + k * stride + width + h, found + k * stride + width + h
                    moved = moved + change * load(key)
                    store(to, load(to) + change * query)
                store(found + q * stride + h, load(found + q * stride + h) + moved)
        rows, found, slopes = rows + seen * stride, found + seen * stride, slopes + slope_stride
        shares, likely = shares + seen * share_stride, likely + seen * seen * width
    return 0


def can_attend(rows: Tensor, heads: int) -> bool:
    """Return whether the kernels can process these rows; otherwise PyTorch's operations do."""
    fits = rows.shape[1] == 3 * HEAD * heads and heads % (BYTES // 4 // HEAD) == 0
    return fits and rows.device.type == "cpu" and rows.dtype == torch.float32 and compiled()


class Means(torch.autograd.Function):
    """Arguments as in `attend`: of rows (rows, 3 * width) and known int64 (agents,), the means (agents, width)."""

    @staticmethod
    def forward(context: Any, rows: Tensor, known: Array) -> Tensor:
        """Compute the means."""
        width, rows, known = rows.shape[1] // 3, rows.contiguous(), np.ascontiguousarray(known)
        likely, shares = (rows.new_empty(count, width) for count in (int(known @ known), len(rows)))
        means = rows.new_empty(len(known), width)
        given = rows.data_ptr(), 12 * width, known.ctypes.data, len(known), width
        context.given = rows, known, likely, shares, given
        called(attend)[0](*given, likely.data_ptr(), shares.data_ptr(), 4 * width, means.data_ptr(), 4 * width)
        return means

    @staticmethod
    def backward(context: Any, slopes: Tensor) -> tuple[Tensor, None]:
        """Compute the gradients of the rows."""
        rows, _, likely, shares, given = context.given
        found, slopes, shares, stride = torch.empty_like(rows), slopes.contiguous(), shares.clone(), 4 * slopes.shape[1]
        more = shares.data_ptr(), stride, slopes.data_ptr(), stride, found.data_ptr()
        called(differentiate)[0](*given, likely.data_ptr(), *more)
        return found, None


@kernel
def _given(call: int, k: int) -> int:
    return word(call + 8 * k)


@kernel
def _field(call: int, layer: int, k: int) -> int:
    return word(_given(call, LAYER) + 8 * (FIELDS * layer + k))


@kernel
def _filled(numbers: int) -> int:
    """Round up to full vectors."""
    return (numbers + VECTOR - 1) // VECTOR * VECTOR


@kernel
def pack(call: int) -> int:
    """Copy the weights of all layers into a row for each input, and a last one for the bias, padded with 0."""
    for layer in range(LAYERS):
        weight, bias = _given(call, WEIGHTS + layer), _given(call, BIASES + layer)
        inputs, outputs = _field(call, layer, INPUTS), _field(call, layer, OUTPUTS)
        by_input, by_output = _field(call, layer, BY_INPUT), _field(call, layer, BY_OUTPUT)
        at, columns = _given(call, WEIGHT_MEMORY) + _field(call, layer, PACKED), _filled(outputs)
        for i in range(inputs):
            for o in range(columns):
                write(at + 4 * o, read(weight + i * by_input + o * by_output) if o < outputs else np.float32(0))
            at += 4 * columns
        for o in range(columns):
            write(at + 4 * o, read(bias + 4 * o) if bias != 0 and o < outputs else np.float32(0))
    return 0


@kernel
def _unpack(call: int) -> None:
    """Copy gradients of all layers from the form of `pack` to that of the weights, one layer after the other."""
    to = _given(call, GRADIENTS)
    for layer in range(LAYERS):
        inputs, outputs = _field(call, layer, INPUTS), _field(call, layer, OUTPUTS)
        by_input, by_output = _field(call, layer, BY_INPUT), _field(call, layer, BY_OUTPUT)
        at, columns = _given(call, FOUND) + _field(call, layer, PACKED), _filled(outputs)
        for i in range(inputs):
            for o in range(outputs):
                write(to + i * by_input + o * by_output, read(at + 4 * o))
            at += 4 * columns
        to += 4 * inputs * outputs
        if _given(call, BIASES + layer) != 0:
            for o in range(outputs):
                write(to + 4 * o, read(at + 4 * o))
            to += 4 * outputs


@kernel
def _apply(call: int, layer: int, agent: int, row: int, agents: int, rows: int) -> None:
    """Apply a layer to some agents and their entities."""
    of_rows = _field(call, layer, X) in (ENTITIES, ROWS)
    first, count = (row, rows) if of_rows else (agent, agents)
    x_stride, y_stride = _field(call, layer, X_STRIDE), _field(call, layer, Y_STRIDE)
    x = _given(call, _field(call, layer, X)) + _field(call, layer, X_OFFSET) + first * x_stride
    y = _given(call, _field(call, layer, Y)) + _field(call, layer, Y_OFFSET) + first * y_stride
    inputs, columns = _field(call, layer, INPUTS), _filled(_field(call, layer, OUTPUTS))
    weights = _given(call, WEIGHT_MEMORY) + _field(call, layer, PACKED)
    low: Any = np.float32(0) if _field(call, layer, RELU) else LOWEST
    bias = weights + 4 * inputs * columns
    product(x, x_stride, 4, weights, 4 * columns, bias, 0, y, y_stride, count, columns, inputs, low)


@kernel
def _differentiate(call: int, layer: int, agent: int, row: int, agents: int, rows: int) -> None:
    """Add the gradients of a layer's weights for some agents, and compute or add the slopes of its inputs."""
    from_, into = _field(call, layer, X), _field(call, layer, Y)
    first, count = (row, rows) if from_ in (ENTITIES, ROWS) else (agent, agents)
    x_stride, y_stride = _field(call, layer, X_STRIDE), _field(call, layer, Y_STRIDE)
    x_offset, y_offset = _field(call, layer, X_OFFSET), _field(call, layer, Y_OFFSET)
    x = _given(call, from_) + x_offset + first * x_stride
    slopes = _given(call, SLOPES + into) + y_offset + (first * y_stride if into in (LOGITS, VALUES) else 0)
    inputs, outputs = _field(call, layer, INPUTS), _field(call, layer, OUTPUTS)
    columns, zero = _filled(outputs), _given(call, ZEROS)
    found = _given(call, FOUND) + _field(call, layer, PACKED)
    bias = found + 4 * inputs * columns
    if _field(call, layer, RELU):
        y = _given(call, into) + y_offset + first * y_stride
        for i in range(count):
            for at in range(i * y_stride, i * y_stride + 4 * outputs, BYTES):
                store(slopes + at, gated(load(slopes + at), load(y + at)))
    product(x, 4, x_stride, slopes, y_stride, found, 4 * columns, found, 4 * columns, inputs, columns, count, LOWEST)
    product(_given(call, ONE), 0, 0, slopes, y_stride, bias, 0, bias, 0, 1, columns, count, LOWEST)
    if from_ in (AGENTS, ROWS):
        weight, by_output = _given(call, WEIGHTS + layer), _field(call, layer, BY_OUTPUT)
        to = _given(call, SLOPES + from_) + x_offset
        start, stride = (to, x_stride) if _field(call, layer, ADDS) else (zero, 0)
        product(slopes, y_stride, 4, weight, by_output, start, stride, to, x_stride, count, inputs, outputs, LOWEST)


@kernel
def _seen(call: int, agent: int, agents: int) -> tuple[int, int]:
    """Count the entities that some agents see, and their pairs."""
    rows, pairs = 0, 0
    for i in range(agent, agent + agents):
        count = word(_given(call, COUNT) + 8 * i)
        rows, pairs = rows + count, pairs + count * count
    return rows, pairs


@kernel
def _clear_unseeing(call: int, features: int, stride: int, agent: int, agents: int) -> None:
    """Clear the features of agents that see no entity, or their slopes."""
    for i in range(agents):
        if word(_given(call, COUNT) + 8 * (agent + i)) == 0:
            for at in range(features + i * stride, features + i * stride + 4 * _given(call, WIDTH), 4):
                write(at, np.float32(0))


@kernel
def _attention(call: int, agent: int, row: int) -> tuple[int, int, int, int, int, int]:
    """Return the addresses of attention's rows, shares and means, with their strides."""
    stride, mean_stride = _field(call, SEEING - 1, Y_STRIDE), _field(call, SEEING, X_STRIDE)
    rows = _given(call, ROWS) + row * stride + _field(call, SEEING - 1, Y_OFFSET)
    means = _given(call, AGENTS) + agent * mean_stride + _field(call, SEEING, X_OFFSET)
    return rows, stride, rows + 12 * _given(call, WIDTH), stride, means, mean_stride


@kernel
def evaluate(call: int) -> int:
    """Compute logits and values of all agents, by packed weights, and keep the intermediate values."""
    row, likely, width = 0, _given(call, LIKELY), _given(call, WIDTH)
    for agent in range(0, _given(call, AGENT_COUNT), BLOCK):
        agents, count = min(BLOCK, _given(call, AGENT_COUNT) - agent), _given(call, COUNT) + 8 * agent
        rows, pairs = _seen(call, agent, agents)
        for layer in range(SEEING):
            _apply(call, layer, agent, row, agents, rows)
        attended, stride, shares, share_stride, means, mean_stride = _attention(call, agent, row)
        attend(attended, stride, count, agents, width, likely, shares, share_stride, means, mean_stride)
        _apply(call, SEEING, agent, row, agents, rows)
        features = _given(call, AGENTS) + agent * mean_stride + _field(call, SEEING, Y_OFFSET)
        _clear_unseeing(call, features, mean_stride, agent, agents)
        for layer in range(SEEING + 1, LAYERS):
            _apply(call, layer, agent, row, agents, rows)
        row, likely = row + rows, likely + 4 * width * pairs
    return 0


@kernel
def backward(call: int) -> int:
    """Compute the gradients of all weights from the slopes of logits and values, after `evaluate`."""
    row, likely, width = 0, _given(call, LIKELY), _given(call, WIDTH)
    for agent in range(0, _given(call, AGENT_COUNT), BLOCK):
        agents, count = min(BLOCK, _given(call, AGENT_COUNT) - agent), _given(call, COUNT) + 8 * agent
        rows, pairs = _seen(call, agent, agents)
        for layer in range(LAYERS - 1, SEEING, -1):
            _differentiate(call, layer, agent, row, agents, rows)
        attended, stride, shares, share_stride, _, mean_stride = _attention(call, agent, row)
        slopes = _given(call, SLOPES + AGENTS)
        _clear_unseeing(call, slopes + _field(call, SEEING, Y_OFFSET), mean_stride, agent, agents)
        _differentiate(call, SEEING, agent, row, agents, rows)
        found = _given(call, SLOPES + ROWS) + _field(call, SEEING - 1, Y_OFFSET)
        slopes += _field(call, SEEING, X_OFFSET)
        differentiate(attended, stride, count, agents, width, likely, shares, share_stride, slopes, mean_stride, found)
        for layer in range(SEEING - 1, -1, -1):
            _differentiate(call, layer, agent, row, agents, rows)
        row, likely = row + rows, likely + 4 * width * pairs
    _unpack(call)
    return 0


@kernel
def choose(call: int, sizes: int, count: int, uniform: int, idle: int, noop: int, actions: int, logs: int) -> int:
    """Draw actions from logits, which are overwritten. Arguments are addresses, but for the number of actions.

    call: As for `evaluate`. sizes: int64 (count,), number of values of each action. uniform: float32 (agents, count),
    from 0 to below 1. idle: bool (agents, count), whether an action is not drawn; 0: all are drawn. noop: int64
    (count,), values of actions that are not drawn. Written are actions: int64 (agents, count); and logs: float32
    (agents,), log-probabilities of the drawn actions.
    """
    row, stride = _given(call, LOGITS), 4 * _filled(_field(call, SEEING + 3, OUTPUTS))
    for i in range(_given(call, AGENT_COUNT)):
        at, joint = row, np.float32(0)
        for k in range(count):
            highest, end = LOWEST, at + 4 * word(sizes + 8 * k)
            for place in range(at, end, 4):
                highest = max(highest, read(place))
            for place in range(at, end, 4):
                write(place, read(place) - highest)
            at = end
        for place in range(at, row + stride, 4):
            write(place, np.float32(0))
        likely, at = _given(call, EXPONENTIALS), row
        for shift in range(0, stride, BYTES):
            store(likely + shift, exponential(load(row + shift)))
        for k in range(count):
            size, total, below, chosen = word(sizes + 8 * k), np.float32(0), np.float32(0), 0
            for place in range(likely, likely + 4 * size, 4):
                total += read(place)
            for place in range(likely, likely + 4 * (size - 1), 4):
                below += read(place)
                chosen += int(below <= read(uniform + 4 * k) * total)
            if idle != 0 and read_flag(idle + k) != 0:
                chosen = word(noop + 8 * k)
            else:
                joint += read(at + 4 * chosen) - np.float32(math.log(total))
            write_word(actions + 8 * k, chosen)
            likely, at = likely + 4 * size, at + 4 * size
        write(logs + 4 * i, joint)
        row, uniform, actions = row + stride, uniform + 4 * count, actions + 8 * count
        idle += count if idle != 0 else 0
    return 0


def functions() -> tuple[Any, ...]:
    """Return the functions for Python: pack, evaluate, backward, choose."""
    return called(pack, evaluate, backward, choose)


class Plan:
    """Layout of the layers of networks in memory.

    Attributes:
        fields: int64 (LAYERS, FIELDS).
        agent, row: Numbers of the record of an agent, and of an entity.
        logits: Numbers of a row of logits, padded.
        size: Numbers of all weights, padded.
    """

    def __init__(self, layout: ObservationLayout, preset: Preset, outputs: int) -> None:
        own, columns, width, hidden = layout.own, layout.columns, preset.width, preset.hidden
        self.logits, self.width = -(-outputs // VECTOR) * VECTOR, width
        first, second, means = 2 * width, 2 * width + 2 * hidden, 2 * width + 4 * hidden  # in the record of an agent
        self.agent, self.row = means + width, 5 * width
        agents, rows = self.agent, self.row
        layers = [  # reads from, writes to: base, offset, stride; inputs, outputs, relu, adds
            (OWN, 0, own, AGENTS, 0, agents, own, width, 1, 0),
            (ENTITIES, 0, columns, ROWS, 0, rows, columns, width, 1, 0),
            (ROWS, 0, rows, ROWS, width, rows, width, 3 * width, 0, 0),
            (AGENTS, means, agents, AGENTS, width, agents, width, width, 0, 0),
            (AGENTS, 0, agents, AGENTS, first, agents, 2 * width, hidden, 1, 1),
            (AGENTS, first, agents, AGENTS, second, agents, hidden, hidden, 1, 0),
            (AGENTS, second, agents, LOGITS, 0, self.logits, hidden, outputs, 0, 0),
            (AGENTS, 0, agents, AGENTS, first + hidden, agents, 2 * width, hidden, 1, 0),
            (AGENTS, first + hidden, agents, AGENTS, second + hidden, agents, hidden, hidden, 1, 0),
            (AGENTS, second + hidden, agents, VALUES, 0, VECTOR, hidden, 1, 0, 0),
        ]
        self.fields, self.size = np.zeros((LAYERS, FIELDS), np.int64), 0
        for to, (x, x_at, x_next, y, y_at, y_next, inputs, results, relu, adds) in zip(
            self.fields, layers, strict=True
        ):
            by_output, by_input = (4, 4 * results) if x == ENTITIES else (4 * inputs, 4)
            places = x, 4 * x_at, 4 * x_next, y, 4 * y_at, 4 * y_next
            to[:] = *places, inputs, results, relu, adds, by_output, by_input, 4 * self.size
            self.size += (inputs + 1) * (-(-results // VECTOR) * VECTOR)
        self.zeros = torch.zeros(max(2 * width, hidden, self.logits) + 1, **FLOAT)
        self.zeros[-1] = 1

    def call(self, seen: Rows, parameters: Sequence[Any], packed: Any = None) -> tuple[Array, list[Any]]:
        """Return the kernels' arguments, and the arrays at their addresses. packed: Weights as of `pack`."""
        known = np.ascontiguousarray(seen.known)
        count, rows, pairs = len(seen), len(seen.entities), int(known @ known)
        sizes = count * self.agent, rows * self.row, count * self.logits, count * VECTOR, pairs * self.width
        agents, entities, logits, values, likely = (torch.empty(size, **FLOAT) for size in sizes)
        packed = torch.empty(self.size, **FLOAT) if packed is None else packed
        kept = seen.own.contiguous(), seen.entities.contiguous(), agents, entities, logits, values
        given = [each.data_ptr() for each in kept] + [self.zeros.data_ptr(), self.zeros[-1].data_ptr(), 0, 0, 0, 0]
        given += [0 if each is None else each.data_ptr() for each in parameters]
        given += [self.fields.ctypes.data, known.ctypes.data, count, self.width]
        given += [packed.data_ptr(), likely.data_ptr(), 0, 0]
        return np.array(given), [*kept, packed, likely, known, *parameters]


class Evaluation(torch.autograd.Function):
    """Arguments as in `evaluated`: logits (agents, outputs) and values (agents,), from weights and biases."""

    @staticmethod
    def forward(context: Any, plan: Plan, seen: Rows, *parameters: Tensor | None) -> tuple[Tensor, Tensor]:
        """Compute both."""
        call, kept = plan.call(seen, parameters)
        for function in functions()[:2]:
            function(call.ctypes.data)
        context.plan, context.call, context.parameters = plan, (call, kept), parameters
        count, outputs = len(seen), len(cast(Tensor, parameters[6]))
        return kept[LOGITS].view(count, plan.logits)[:, :outputs], kept[VALUES].view(count, VECTOR)[:, 0]

    @staticmethod
    def backward(context: Any, logits: Tensor, values: Tensor) -> tuple[Any, ...]:
        """Compute the gradients of the parameters. It can be called once only, since it overwrites its input."""
        plan, (call, kept), parameters = context.plan, context.call, context.parameters
        del context.call
        count, most = len(values), 0
        if count:
            most = int(np.add.reduceat(kept[8], np.arange(0, count, BLOCK)).max())
        slopes = torch.empty(BLOCK * plan.agent, **FLOAT), torch.empty(most * plan.row, **FLOAT)
        ends = torch.zeros(count, plan.logits, **FLOAT), torch.zeros(count, VECTOR, **FLOAT)
        ends[0][:, : logits.shape[1]], ends[1][:, 0] = logits, values
        sizes = [0 if each is None else each.numel() for each in parameters]
        order = [k for pair in zip(range(LAYERS), range(LAYERS, 2 * LAYERS), strict=True) for k in pair]
        found, gradients = torch.zeros(plan.size, **FLOAT), torch.empty(sum(sizes), **FLOAT)
        call[SLOPES + AGENTS : SLOPES + VALUES + 1] = [each.data_ptr() for each in (*slopes, *ends)]
        call[FOUND:] = found.data_ptr(), gradients.data_ptr()
        functions()[2](call.ctypes.data)
        each = dict(zip(order, torch.split(gradients, [sizes[k] for k in order]), strict=True))
        return None, None, *(None if given is None else each[k].view(given.shape) for k, given in enumerate(parameters))


class Acting:
    """A chooser of agents' actions, valid while the weights do not change."""

    def __init__(self, networks: Any) -> None:
        """Compile `networks`, an ActorCritic for which this is `possible`."""
        self.plan: Plan = networks.plan
        self.parameters = _parameters(networks)
        self.sizes, self.packed = np.array(networks.sizes, np.int64), torch.empty(self.plan.size, **FLOAT)
        self.room = torch.empty(self.plan.logits, **FLOAT)
        none = torch.empty((0, 1), **FLOAT)
        seen = Rows(none, none, torch.zeros(0, **INDEX))
        call, _kept = self.plan.call(seen, self.parameters, self.packed)  # kept until the kernel has read it
        functions()[0](call.ctypes.data)

    def __call__(self, seen: Rows, uniform: Array, idle: Array | None, noop: Array) -> tuple[Array, Tensor, Tensor]:
        """Return the actions, int64 (agents, actions), their log-probabilities and the values, float32 (agents,).

        uniform: float32 (agents, actions), random numbers from 0 to below 1. idle: bool (agents, actions), whether an
        action is not drawn but has the value in `noop`, int64 (actions,); None: all are drawn.
        """
        count, uniform = len(seen), np.ascontiguousarray(uniform)
        call, kept = self.plan.call(seen, self.parameters, self.packed)
        idle = None if idle is None else np.ascontiguousarray(idle)
        call[EXPONENTIALS] = self.room.data_ptr()
        actions, logs = np.empty((count, len(self.sizes)), np.int64), np.empty(count, np.float32)
        given = uniform.ctypes.data, 0 if idle is None else idle.ctypes.data, noop.ctypes.data
        written = actions.ctypes.data, logs.ctypes.data
        _, evaluating, _, choosing = functions()
        evaluating(call.ctypes.data)
        choosing(call.ctypes.data, self.sizes.ctypes.data, len(self.sizes), *given, *written)
        return actions, torch.from_numpy(logs), kept[VALUES].view(count, VECTOR)[:, 0]


def evaluated(networks: Any, seen: Rows) -> tuple[Tensor, Tensor]:
    """Return logits (agents, outputs) and values (agents,) of an ActorCritic for which they are `possible`."""
    found = Evaluation.apply(networks.plan, seen, *_parameters(networks))  # type: ignore[no-untyped-call]
    return cast(tuple[Tensor, Tensor], found)


def _parameters(networks: Any) -> list[Any]:
    """Return the weights of all layers, and then their biases, which may be None."""
    extractor, actor, critic = networks.extractors[0], networks.actor, networks.critic
    entities = torch.cat([extractor.weight * extractor.scale, extractor.bias])
    own, attention = extractor.own.weight * extractor.own_scale, extractor.attention
    layers = [attention.out_proj, *(getattr(tower, name) for tower in (actor, critic) for name in TOWER)]
    weights = [own, entities, attention.in_proj_weight, *(layer.weight for layer in layers)]
    biases = [extractor.own.bias, None, attention.in_proj_bias, *(layer.bias for layer in layers)]
    return [*weights, *biases]


def plan(networks: Any) -> Plan | None:
    """Return the memory layout of the layers of an ActorCritic; None if the kernels cannot compute them."""
    preset = networks.preset
    simple = preset.shared and not (preset.leaky or networks.memory or networks.state) and preset.activation == "relu"
    fits = preset.width % VECTOR == preset.hidden % VECTOR == 0 and preset.width == HEAD * preset.heads
    return Plan(networks.layout, preset, sum(networks.sizes)) if simple and fits and compiled() else None


def able(networks: Any) -> bool:
    """Return whether the kernels can read the weights of networks."""
    like = networks.plan and networks.actor.last.weight
    return like is not None and like.device.type == "cpu" and like.dtype == torch.float32


def possible(networks: Any, seen: Any) -> bool:
    """Return whether the kernels can compute the outputs of networks for these inputs."""
    return able(networks) and isinstance(seen, Rows) and seen.room is None
