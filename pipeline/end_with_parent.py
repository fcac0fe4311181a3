"""Importing this ends the process with the one that started it, however that ends.

The first module that the server of worker processes imports: the workers end with it, and it with the night, also while
it is still importing what they need. Linux only; elsewhere the server notices when it has nothing else to do.
"""

import os

from ingest.apart import end_with_parent

end_with_parent()
# The process that starts the server may be gone before the kernel is told.
if os.environ.get("DEALAB_PARENT") not in (None, str(os.getppid())):
    os._exit(1)
