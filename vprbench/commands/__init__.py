"""The commands: `at_once` answers without waiting for a library, `working` does the rest."""
