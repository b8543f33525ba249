"""What verbs share: the configuration, options, columns, keys pressed, work on all cores."""
