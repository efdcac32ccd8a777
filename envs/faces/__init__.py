"""Faces: the same worlds in the shape that each library wants. Each stands on the batch of worlds (envs/vector.py).

Gymnasium: `single` (one learner), `learners` (the same, many at a time), `agents` (every agent a sub-environment); they
share `face` and `rows`. PettingZoo: `parallel`, `zoo`. `sb3`, `rllib`, `puffer`: what their names say.
"""
