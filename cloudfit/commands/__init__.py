"""The commands of the program; each imports what it needs when it runs, so that `--help` answers at once."""
