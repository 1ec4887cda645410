"""Resources of the cell, and the commands using resources: the resource net ``cell``, and the command queue.

``resources`` names what there is, ``needs`` what each command takes, ``net`` makes the net of it, ``line`` says whose
turn it is.
"""
