"""Adapters: core.vector_env.SurvivalVectorEnv in the form that each library expects.

Gymnasium: `gymnasium_single` (one learner), `gymnasium_learners` (many worlds with one learner each),
`gymnasium_agents` (every agent is a sub-environment). The others are called after their libraries.
"""
