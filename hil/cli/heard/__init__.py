"""Commands for a bus or its log: scope, explain, export."""
