"""Losses and networks of one's own for outlast.train, as docs/training.md shows them."""

import torch
from torch import nn

from outlast.training.policies.policy import ActorCritic, Networks
from outlast.training.ppo.loss import ppo_loss


def kl_penalty(batch):
    """PPO with a penalty for the divergence from the old policy in place of the clip."""
    divergence = batch.mean(batch.ratio - 1 - batch.log_ratio)
    policy = 3.0 * divergence - batch.mean(batch.advantages * batch.ratio)
    value = batch.mean((batch.returns - batch.values).square())
    loss = policy + batch.numbers.vf_coef * value - batch.numbers.ent_coef * batch.mean(batch.entropy)
    return loss, {"policy_loss": policy, "value_loss": value}


class Predicting(ActorCritic):
    """The preset's networks, and a head that predicts from their features what the agent observes of itself."""

    def __init__(self, sizes, **given):
        super().__init__(sizes, **given)
        self.head = nn.Linear(2 * self.preset.width, self.layout.own)


def predicting(batch):
    """PPO with the error of that prediction as an auxiliary term."""
    loss, figures = ppo_loss(batch)
    guess = batch.network.head(batch.network.extractors[0](batch.seen))
    error = batch.mean((guess - batch.seen.own).square().mean(1))
    return loss + 0.01 * error, {**figures, "prediction": error}


class Pooled(Networks):
    """A deep set: the rows that an agent sees are embedded and added up."""

    def __init__(self, sizes, **given):
        super().__init__(sizes, **given)
        self.own, self.row = nn.Linear(self.layout.own, 32), nn.Linear(self.layout.columns, 32)
        self.last = nn.Linear(64, sum(sizes) + 1)

    def forward(self, seen, memory=None, begins=None):
        rows = self.row(seen.entities).relu()
        sums = rows.new_zeros(len(seen), 32).index_add(0, seen.agent, rows)
        last = self.last(torch.cat([self.own(seen.own).relu(), sums], 1))
        return self.choices.log_softmax(last[:, :-1]), last[:, -1], memory
