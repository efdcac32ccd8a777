"""The commands of the command line: one file each, with its options (`add`) and what it does (`run`)."""
