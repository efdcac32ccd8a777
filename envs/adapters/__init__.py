"""Adapters: the same worlds in the form that each library expects, on top of core.vector_env.SurvivalVectorEnv.

Gymnasium: `gymnasium_single` (one learner), `gymnasium_learners` (the same, many at a time), `gymnasium_agents` (every
agent a sub-environment). `pettingzoo`, `sb3`, `rllib` and `puffer` are for the library of that name. `per_agent` is
their common base; `registry` enters them in Gymnasium's and PettingZoo's registries.
"""
