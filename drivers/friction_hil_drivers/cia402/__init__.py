"""CiA 402, the drive profile, as far as every bus and both ends of it share it."""
