"""The commands of `dealab`, a file each: what it does, examples, its arguments, and what it runs, in one `Command`.

All of them are imported for `dealab --help`, so none imports more than it needs to describe itself: what a command
works with is imported when it runs. A new command is a file here and its name in `pipeline.cli`.
"""
