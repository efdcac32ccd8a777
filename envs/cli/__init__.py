"""The command line: files of commands that belong together, each a function with its help; options of several."""
