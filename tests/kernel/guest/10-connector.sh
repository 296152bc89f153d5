# Tests the listener with this kernel's connector and messages from user space.
CSI5300_TEST_NAMESPACE=own /tests/live connector:: --test-threads=1
