"""All commands in short: what `outlast` alone and `outlast help` print."""

from typing import Any

SECTIONS = {
    "games": ("variants", "numbers", "new", "layout", "schedule", "check"),
    "play and look": ("rollout", "frames", "play", "replay"),
    "train and compare": ("train", "watch", "models", "evaluate", "plot", "benchmark"),
    "help": ("help", "completion"),
}  # in the order of first use; what is in none of them comes behind


def overview(program: str, commands: Any) -> str:
    """Return each command with what it does and an example, in sections. commands: of argparse's add_subparsers."""
    about, listed = summaries(commands), []
    for title, names in sections(commands).items():
        listed += ["", f"{title}:"]
        for name in names:
            listed.append(f"  {name:<11} {about[name]}")
            listed += [f"  {'':<11}   {program} {text}" for text, _ in commands.choices[name].examples[:1]]
    return "\n".join([*listed[1:], "", f"`{program} help COMMAND` shows the options of a command."])


def sections(commands: Any) -> dict[str, list[str]]:
    """Return the names of the commands that there are, by section."""
    known = {name for names in SECTIONS.values() for name in names}
    more = {"more": [name for name in commands.choices if name not in known]}
    found = {title: [name for name in names if name in commands.choices] for title, names in SECTIONS.items()} | more
    return {title: names for title, names in found.items() if names}


def summaries(commands: Any) -> dict[str, str]:
    """Return the line about each command, by name."""
    return {choice.dest: choice.help or "" for choice in commands._choices_actions}
