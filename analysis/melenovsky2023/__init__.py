"""The estimator of A. Melenovský, BSc thesis, CTU Prague 2023, beside which ours is judged."""
