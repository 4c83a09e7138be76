"""What the driver does without a run: finding, showing and stopping drives, logs, new configurations."""
