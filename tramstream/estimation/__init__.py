"""What all estimators share: covariance algebra, the localiser's contract, messages."""
