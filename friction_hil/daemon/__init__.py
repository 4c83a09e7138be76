"""The daemon: the fixed-period loop between drives and compensators, and the companion process that records."""
