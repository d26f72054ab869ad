"""The built-in global methods: a module is a method, named after its file."""
