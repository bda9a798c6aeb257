"""Commands, run in the Blender of the tests."""

from crowd_lod_extension.operators.cli import commands


def run(*words) -> int:
    """Run a command; return its exit code."""
    return commands.run_command([str(word) for word in words], "crowd-lod")


def quietly(*words) -> int:
    """Run a command that tells nothing of its progress."""
    return run(*words, "--quiet")
