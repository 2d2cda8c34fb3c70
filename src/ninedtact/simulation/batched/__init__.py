"""Many sessions at once on one device: what a GPU makes data sets with.

play.py      sessions go on in step: all that look are shown, then all that step are stepped; read this first
room.py      their questions answered in batches, smaller ones when memory runs out
steps.py     one batch of steps, from overlap to contacts; judging.py what each hand is told of them
windows.py   where on the patch each contact may be; skins.py the skins of several sensors stacked; held.py loads and depths
objects.py   several objects, each over its own contact
weighing.py  contacts of one sensor in numbers
device.py    which device; refused by name where there is none
"""
