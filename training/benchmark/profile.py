"""The figure of performance profiles: shares of seeds and tasks that score above a threshold. Needs matplotlib."""

import hashlib
import json

from matplotlib.figure import Figure

from ..plots.figure import encoded, figure_of, look
from .scores import Scores

SIZE = (7.0, 3.4)  # inches


def picture(own: Scores, title: str) -> bytes:
    """Return the figure as a PNG; the same scores give the same bytes."""
    source = hashlib.sha256(json.dumps(own["profile"], sort_keys=True).encode()).hexdigest()
    return encoded(lambda: _draw(own, title), "png", {"Title": title, "Source": source})


def _draw(own: Scores, title: str) -> Figure:
    figure = figure_of(*SIZE, layout="constrained")
    axes, thresholds = figure.subplots(), own["profile"]["thresholds"]
    count = len(own["common"])
    axes.set_title(f"Performance profiles, {title}, {count} task{'s' * (count > 1)}")
    agents = [name for name in own["profile"] if name != "thresholds"]
    for k, agent in enumerate(agents):
        each, (ink, dash) = own["profile"][agent], look(k)
        axes.step(thresholds, each["value"], where="post", color=ink, linestyle=dash, linewidth=1.7, label=agent)
        if "low" in each:
            axes.fill_between(thresholds, each["low"], each["high"], step="post", color=ink, alpha=0.16, linewidth=0)
    axes.set(
        xlim=(0, 1), ylim=(0, 1.02), xlabel="score: win rate against the suite", ylabel="share of seeds that score more"
    )
    axes.legend(frameon=False)
    return figure
