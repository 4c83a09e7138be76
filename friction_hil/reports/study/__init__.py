"""The report of a study: pictures, tables, and what they show, in plain words."""
