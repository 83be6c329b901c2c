"""Many pieces of work at once: processes of this machine or of a cluster, and the ledger of what is done."""
