"""The subcommands: a module each, with a plain function. A new one is one file here and one line in `program`."""
