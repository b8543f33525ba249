"""The command line: the outermost layer, which may import everything and is imported by nothing."""
