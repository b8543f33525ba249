"""Imported once by the server that nodes are forked from: importing it is its whole effect."""

import gc
import os

# One thread each: a forked process does not inherit threads, and nodes use one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tramstream.supervision.process import import_nodes

import_nodes()
gc.collect()
gc.freeze()  # else the first collection in every node would copy all pages
