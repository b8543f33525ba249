"""Compiled kernels: how they are kept, compiled side by side, and known to be this user's."""
