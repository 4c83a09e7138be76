"""CiA 402, the drive profile: what drivers and simulated drives of every bus have in common."""
