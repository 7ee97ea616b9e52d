"""Paper 4 reproduced: a fuzzy system, tuned by optimisers, finds the noise of a Kalman filter."""
