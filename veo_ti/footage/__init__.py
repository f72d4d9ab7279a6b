"""What the commands for filmed material do: calibrate cameras, follow the nozzle, cut the object out."""
