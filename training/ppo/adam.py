"""Adam (Kingma and Ba, arXiv:1412.6980), by the functional form of torch.optim.

The class `torch.optim.Adam` imports PyTorch's compiler, of which nothing is used here: 800 modules, 80 MB, and seconds.
"""

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam

EPSILON = 1e-5  # is added to the root of the second moment, as in Stable-Baselines3
NAMES = "step", "exp_avg", "exp_avg_sq"  # of what a parameter's moments consist of


class Adam:
    """Adam with the usual rates of decay.

    moments: Of each parameter, in order: steps taken, float32 without axes, and averages of gradients and of their
    squares, like the parameter.
    """

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        self.parameters = list(parameters)
        self.moments = [
            {"step": torch.zeros((), dtype=torch.float32, device=each.device)}
            | {name: torch.zeros_like(each, requires_grad=False) for name in NAMES[1:]}
            for each in self.parameters
        ]

    @torch.no_grad()
    def step(self, rate: float) -> None:
        """Change the parameters by their gradients. rate: The learning rate."""
        gradients = [each.grad for each in self.parameters if each.grad is not None]
        steps, averages, squares = ([own[name] for own in self.moments] for name in NAMES)
        adam(
            self.parameters,
            gradients,
            averages,
            squares,
            [],
            steps,
            fused=True,
            lr=rate,
            beta1=0.9,
            beta2=0.999,
            eps=EPSILON,
            weight_decay=0.0,
            amsgrad=False,
            maximize=False,
        )

    def restore(self, moments: Sequence[Mapping[str, Tensor]]) -> None:
        """Go on from copies of such moments, which may be on another device."""
        for own, given in zip(self.moments, moments, strict=True):
            for name, values in own.items():
                values.copy_(given[name])
