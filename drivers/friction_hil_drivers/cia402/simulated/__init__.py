"""A simulated CiA 402 drive: device control, loops and motor behind an object dictionary, without a bus."""
