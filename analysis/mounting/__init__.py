"""How an IMU is turned in its vehicle, found from rides: coarse, by smoothing, with a verdict."""
