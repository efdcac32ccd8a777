"""Adapters: the same worlds in the shape that each library wants. Each stands on the batch of worlds (core.vector_env).

Gymnasium: `gymnasium_single` (one learner), `gymnasium_learners` (the same, many at a time), `gymnasium_agents` (every
agent a sub-environment); they share `per_agent` and `rows`. `pettingzoo`, `sb3`, `rllib` and `puffer` are what their
names say.
"""
