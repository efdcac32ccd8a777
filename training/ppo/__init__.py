"""The learner: a rollout from many worlds, the loss of PPO, minibatches and updates, on one or several processes.

It does not import runs, pages or the paper; `trainer.Trainer` collects and updates, and does not write files.
"""
