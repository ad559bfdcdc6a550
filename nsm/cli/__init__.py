"""Tool box of all commands: configuration, validation, errors, help, progress, and atomic files."""
