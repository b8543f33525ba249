"""`tramstream reproduce` of the published works: one module a work, its figures beside ours."""
