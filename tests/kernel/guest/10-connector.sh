# The listener against this kernel's connector, with the messages of user space.
CSI5300_TEST_NAMESPACE=own /tests/live connector:: --test-threads=1
