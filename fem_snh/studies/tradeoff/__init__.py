"""How much accuracy each second buys on a scene: every knob measured against the others.

knobs      what can be set, each value by name
grid       which settings are tried
reference  what the right answer is, and how well it is known
errors     of every row, against it
advice     what to use, in words and as a table
accuracy   a run chosen from such a table: `fem-snh run SCENE --accuracy 1%`
study      all of it
"""
