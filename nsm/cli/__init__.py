"""What every command needs around its work: configuration, validation, errors, and atomic files."""
