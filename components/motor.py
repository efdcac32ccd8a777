"""Actions of movement: Drive with Motors, Steer with Steering, Throttle with FineMotors or FineSteering."""

import numpy as np

from outlast.ecs import Action, Array, column

HUNDREDTH = np.float32(0.01)  # share of full thrust or speed for 1 in Throttle


class Control:
    """The slot of Motors, Steering and the fine ones, of which a scenario has at most one. See Module.slot."""


class Drive(Action, order=0):
    """Direction of the push in the agent's own frame: ahead, to the left, and counter-clockwise."""

    ahead: Array = column("i1", "agents", low=-1, high=1)
    left: Array = column("i1", "agents", low=-1, high=1)
    turn: Array = column("i1", "agents", low=-1, high=1)


class Steer(Action, order=0):
    """Speed in the agent's own frame, in thirds of the maximum: ahead, to the left, and counter-clockwise."""

    ahead: Array = column("i1", "agents", low=-3, high=3)
    left: Array = column("i1", "agents", low=-3, high=3)
    turn: Array = column("i1", "agents", low=-3, high=3)


class Throttle(Action, order=0):
    """Push or speed in the agent's own frame, in hundredths of the maximum: ahead, left and counter-clockwise."""

    ahead: Array = column("i1", "agents", low=-100, high=100)
    left: Array = column("i1", "agents", low=-100, high=100)
    turn: Array = column("i1", "agents", low=-100, high=100)
