"""YAML files that are checked as a whole: every mistake with its file, line and key.

Model files, configurations, descriptions of drives and column mappings are such files. `text` reads YAML and knows
the line of each key, `section` declares keys, `messages` words pydantic's errors, `files` puts it together.
"""
