"""The bench in a browser: a page that starts the ordinary commands, a process beside it that stops them."""
