"""What all drives on serial lines share: the line, exchanges on it, their description, the axis behind it."""
