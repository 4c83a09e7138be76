"""Reading and checking of YAML files; every mistake is reported with its file, line and key.

Model files, configurations, drive descriptions and column mappings are read this way. `text` parses YAML and records
the line of each key, `section` declares keys, `messages` turns pydantic's errors into messages for the user, and
`files` combines them.
"""
