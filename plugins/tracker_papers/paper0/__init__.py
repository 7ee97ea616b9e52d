"""Paper 0 reproduced: two stations measure the azimuth of a ship; EKF1, EKF2 and UKF, each with RTS."""
