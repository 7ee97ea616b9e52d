"""``python -m tracker``: the command line; what the commands do lives in `tracker.cli`."""

from tracker.cli import main

main()
