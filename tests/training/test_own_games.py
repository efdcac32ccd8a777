"""Games of one's own are trained, evaluated and compared like the variants, whatever mechanics they have."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import pytest

import outlast
from outlast import variant
from outlast.components import Phase, Side
from outlast.ecs import Array, Entity, Module, Read, Rows, Statistic, Write, column

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training.base.errors import TrainingError  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


@dataclass(frozen=True)
class Steps(Module):
    """Counts what agents and sides live to see."""

    name: ClassVar[str] = "steps_lived"

    def singletons(self) -> list[Any]:
        return [Lived()]


class Lived(Statistic):
    """Ticks in which agents and sides lived."""

    lived: Array = column("i4", "agents")
    team_lived: Array = column("i4", "sides")


@Steps.system(Phase.RECORD)
def count_steps(entities: Read[Entity], agents: Rows[Side], side: Read[Side], counts: Write[Lived]) -> None:
    for i in range(agents.size):
        if entities.alive[agents[i]]:
            counts.lived[i] += 1
            counts.team_lived[side.side[agents[i]]] += 1


def test_statistics_of_ones_own_are_columns() -> None:
    """Of agents the mean over them, of sides the sum, as of the game's own return and kills."""
    game = variant("teams_2").replace(safe_zone_damage=50, safe_zone_stand=10, safe_zone_shrink=5).with_(Steps())
    found = outlast.evaluate(game, ["noop", "random"], episodes=8, worlds=4, quiet=True)
    for pair in (("noop", "random"), ("random", "noop")):
        of = found.estimates(*pair)
        assert of["team_lived"][0] == pytest.approx(2 * of["lived"][0])
        assert 0 < of["lived"][0] <= of["life"][0]


def test_games_without_melee_or_records() -> None:
    """A game of one's own need not have them."""
    game = variant("ffa_1").replace(safe_zone_damage=50, safe_zone_stand=10, safe_zone_shrink=5)
    found = outlast.evaluate(game.without("melee"), ["noop"], episodes=2, worlds=2, quiet=True)
    assert "near" not in found.estimates("noop", "noop")
    with pytest.raises(TrainingError, match=r"ffa_1\S* has no statistic 'length': add the mechanic Record"):
        outlast.evaluate(game.without("record"), ["noop"], quiet=True)


ITEMS = ("inventory", "pickup", "give_last", "death_drop", "heals")


@pytest.mark.parametrize(
    ("without", "words"),
    [
        (("record",), r"ffa_1\S* has no statistic 'length': add the mechanic Record"),
        (("agents",), "'agent', but none declares how many there are; add Agents"),
        (("motors", "melee", *ITEMS), "agents have no actions here: add a mechanic with some, such as Motors"),
    ],
)
def test_games_that_cannot_be_trained_say_so_before_anything_is_made(
    without: tuple[str, ...], words: str, tmp_path: Path
) -> None:
    with pytest.raises(outlast.errors.OutlastError, match=words):
        outlast.train(variant("ffa_1").without(*without), tmp_path / "run", worlds=2, rollout=64, quiet=True)
    assert not (tmp_path / "run").exists()


def test_a_game_without_melee_is_trained(tmp_path: Path) -> None:
    """The behaviour that is logged needed the reach of a melee."""
    game = variant("ffa_1").replace(safe_zone_damage=50, safe_zone_stand=10, safe_zone_shrink=5)
    small: dict[str, Any] = {"steps": 1, "worlds": 8, "rollout": 512, "threads": 1, "quiet": True}
    run = outlast.train(game.without("melee").with_(Steps()), tmp_path / "run", **small)
    assert "behaviour/near" not in run.logged
    assert run.logged["rollout/lived0"] > 0
    found = outlast.plot(tmp_path / "run", tmp_path / "out", curves=("lived", "team_lived", "return"))
    assert found.panels[0].title == "lived, mean over sides"  # each agent is one
    assert run.policy.exists()


def test_a_plot_says_whether_numbers_are_of_agents_or_of_sides(tmp_path: Path) -> None:
    game = variant("teams_2").replace(safe_zone_damage=50, safe_zone_stand=10, safe_zone_shrink=5)
    run = outlast.train(game.with_(Steps()), tmp_path / "run", steps=1, worlds=8, rollout=512, threads=1, quiet=True)
    found = outlast.plot(run.folder, tmp_path / "out", curves=("lived", "team_lived", "return"))
    titles = ["lived, mean over agents", "team lived, mean over sides", "return, mean over sides"]
    assert [panel.title for panel in found.panels] == titles


def test_figures_of_agents_are_means_over_episodes_however_many_agents_they_have() -> None:
    game = variant("teams_2").vary(n_agents=outlast.integers(2, 4)).replace(ending_limit=60)
    found = outlast.evaluate(game.with_(Steps()), ["scripted", "noop"], episodes=24, worlds=8, quiet=True)
    (match,) = (pairing.results for pairing in found.pairings if pairing.pair == (0, 1))
    lived = match.figures["lived"][:, :, 0]
    assert (lived[..., 1] == 1).all()
    assert (lived[..., 0] <= 60).all()  # ticks of one agent
    assert found.estimates("scripted", "noop")["lived"][0] == pytest.approx(lived[..., 0].mean())


class Strong(outlast.systems.Melee):
    """A melee under another name."""

    name = "strong"


def test_a_subclass_of_melee_has_its_reach() -> None:
    game = variant("ffa_1").replace(safe_zone_damage=50, safe_zone_stand=10, safe_zone_shrink=5)
    shares = []
    for reach in (1.0, 24.0):
        found = outlast.evaluate(game.with_(Strong(reach=reach)), ["noop"], episodes=2, worlds=2, quiet=True)
        shares.append(found.estimates("noop", "noop")["near"][0])
    assert shares[0] < 0.1 < shares[1]
