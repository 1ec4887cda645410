"""Resources of the cell, and the commands using resources: the resource net ``cell``, and the command queue.

``needs`` names what there is, and what each command takes, ``net`` makes the net of it, ``queue`` says whose turn it
is.
"""
