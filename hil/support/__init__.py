"""What programs need on a computer and robots do not: files, signals, progress, machine code."""
