"""Slopes of a route from rides over it: the estimators of chladek2023, baselines, and ours."""
