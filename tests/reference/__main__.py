"""Compare whole episodes of the engine with the slow reference, tick by tick.

    python -m tests.reference [VARIANT ...] [--policy NAME] [--episodes N]
        [--seed N]

A line for each episode says where the two diverge, if they do.
"""

import argparse
import sys

from outlast import variant
from outlast.envs.rollout.policies import POLICIES
from tests.reference.episodes import compare, held, record


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        "python -m tests.reference", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    text = "variants to play (default ffa_4 teams_4)"
    parser.add_argument("variants", nargs="*", metavar="VARIANT", default=["ffa_4", "teams_4"], help=text)
    text = "who plays; held: random actions, of which agents hold a direction for some ticks (default held)"
    parser.add_argument("--policy", default="held", choices=["held", *POLICIES], metavar="NAME", help=text)
    parser.add_argument("--episodes", type=int, default=20, help="episodes of each variant (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="seed of worlds and actions (default %(default)s)")
    options = parser.parse_args(arguments)
    for name in options.variants:
        policy = {"held": held, **POLICIES}[options.policy]
        for episode in record(variant(name), options.episodes, options.seed, policy):
            print(name, compare(episode), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
