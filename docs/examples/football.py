"""Football, two against two: agents push a ball that bounces, and a goal pays one side and costs the other."""

from dataclasses import dataclass

from yard import yard

from outlast import systems
from outlast.components import Body, Look, Material, Outcome, Phase, Reward, SelfView, Shape, Side, Solid
from outlast.ecs import INDEX, Archetype, Array, Component, Module, Read, Rows, Write, column, kernel, number, ref
from outlast.systems.observation_rows import more_fields


class Ball(Component):
    """What is to get into a goal."""


class Goal(Component):
    """A line on the floor."""

    side: Array = column("i4", unit="side")  # which defends it


@dataclass(frozen=True)
class Football(Module):
    """The goals are the middles of the left and the right wall; side 0 plays to the right."""

    goal: float = number(2.0, above=0, unit="metres", about="half the width of a goal")

    def archetypes(self):
        """A light ball that rolls on, and lines that show where the goals are."""
        lively = Material(friction=0.1, restitution=0.8, linear_damping=0.4)
        ball = Body(), Shape(radius=0.3), Solid(dynamic=1, density=0.3), lively, Ball()
        goal = Body(), Shape(half_width=0.25, half_height=ref("goal")), Goal(side=INDEX)
        return [Archetype("ball", ball, 1), Archetype("goal", goal, 2)]

    def singletons(self):
        """Outcome says who wins: who has more goals."""
        return [Reward(), Outcome()]

    def fields(self):
        """Agents always know where the ball is."""
        return {"own": BALL}

    def looks(self):
        """The ball is white, and goals have the colour of the side that defends them."""
        return {"ball": Look(color=(255, 255, 255)), "goal": Look(tint=Goal.side)}


@kernel
def ball_x(i, e, body: Read[Body], balls: Rows[Ball]) -> float:
    """Metres to the ball along x."""
    return body.x[balls[0]] - body.x[e]


@kernel
def ball_y(i, e, body: Read[Body], balls: Rows[Ball]) -> float:
    """Metres to the ball along y."""
    return body.y[balls[0]] - body.y[e]


BALL = more_fields(Football, SelfView, "own", Side, ball_x=ball_x, ball_y=ball_y)


@Football.system(Phase.SPAWN, after=Body)
def put_up(body: Write[Body], goals: Rows[Goal], room_size: float) -> None:
    """The goals stand at the walls."""
    for k in range(goals.size):
        body.x[goals[k]] = (k - 0.5) * (room_size - 0.5)


@Football.system(Phase.SURROUND)
def score(
    body: Write[Body],
    outcome: Write[Outcome],
    reward: Write[Reward],
    side: Read[Side],
    agents: Rows[Side],
    balls: Rows[Ball],
    room_size: float,
    goal: float,
) -> None:
    """A ball that touches a goal goes back to the middle."""
    e = balls[0]
    if 0.5 * room_size - abs(body.x[e]) < 0.5 and abs(body.y[e]) < goal:
        scorer = 0 if body.x[e] > 0 else 1
        outcome.outcome[scorer] += 1
        for i in range(agents.size):
            reward.reward[i] += 1 if side.side[agents[i]] == scorer else -1
        body.x[e], body.y[e], body.vx[e], body.vy[e] = 0, 0, 0, 0


FOOTBALL = yard("football", Football(), agents=4, size=16.0).with_(systems.Teams(count=2)).without("rewards")
