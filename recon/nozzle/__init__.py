"""The air nozzle from its ArUco marker: every pose hypothesis, one consistent path, its covariance and its gaps."""
