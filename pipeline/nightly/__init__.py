"""A night: raw files in; what is new is read, what depends on it is made again, and the lab is published anew.

    night.py
    │
    │   raw files
    │      │
    ├─ look.py         which raw files there are, and which content each has
    │      │
    ├─ read.py         contents that are new become recordings, in workers ─────────────┐
    │      │           (ownership.py decides which content is which recording,          │  finished results
    │      │           and what each row of `recordings` says)                          ├─ lie in the journal
    │      │                                                                            │  until they are
    ├─ derive.py       specimens, diagnoses and groups whose recordings changed         │  published
    │      │           are made again, in workers ──────────────────────────────────────┘
    │      │
    ├─ publish.py      samples and refused files in their places, then the next database
    │      │
    └─ reports         pages, from the published database alone

    What all steps use:
       stages.py       what there is to make: recording, specimen, diagnosis, group; and what the steps share
       freshness.py    what needs not be made: same input, same code, same settings
       ledger.py       what is known of every file and result, on disk while the night is at work
       workers.py      other processes, and what happens when one does not come back

The words of a night:

    raw file     a file that may be a recording, below the folders and addresses that the night was given
    content      what is in a raw file, known by its SHA-256; copies are several raw files with one content
    recording    what a content holds: one test run of a specimen, known by its recording_id. A table that stands
                 instead of recordings counts as one.
    row          what the table `recordings` says about one raw file and its content: ok, damaged, quarantined,
                 duplicate, pending or excluded
    look         what was found of one raw file tonight
    item         one piece of work that has results: a content, a specimen, a diagnosis or a group
    outcome      how an item ended
"""
