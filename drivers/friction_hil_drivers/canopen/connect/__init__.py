"""From a node number to a configured drive: who is there, mapping, watchdogs, what is to be restored."""
