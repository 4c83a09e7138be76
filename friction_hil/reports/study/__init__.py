"""The report of a study: pictures, tables and explanations."""
