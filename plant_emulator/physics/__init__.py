"""The compiled plant: axes with angular transmission errors, and the tip they move."""
