"""Adapters: core.vector_env.SurvivalVectorEnv in the form that each library expects.

Gymnasium: `gymnasium_single` (one learner), `gymnasium_learners` (many worlds with one learner each),
`gymnasium_agents` (every agent is a sub-environment). `pettingzoo`, `sb3`, `rllib`, `puffer`, `torchrl` and `benchmarl`
are for the libraries of these names. `per_agent` is the base of adapters whose sub-environments are single agents;
`registry` adds scenarios to Gymnasium's and PettingZoo's registries.
"""
