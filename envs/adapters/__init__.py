"""Adapters: the same worlds in the form that each library expects, on top of core.vector_env.SurvivalVectorEnv.

Gymnasium: `gymnasium_single` (one learner), `gymnasium_learners` (many worlds with one learner each),
`gymnasium_agents` (every agent is a sub-environment). `pettingzoo`, `sb3`, `rllib`, `puffer`, `torchrl` and `benchmarl`
are for the libraries of these names. `per_agent` is a common base; `registry` adds scenarios to Gymnasium's and
PettingZoo's registries.
"""
