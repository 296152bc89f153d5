# The module on 6.12: both functions that it wants are there, and records come out of calls such as iwldvm makes.
for module in rfkill libarc4 cfg80211 mac80211 iwlwifi iwldvm; do load "$module"; done
counter() { cat "/sys/module/csi5300/counters/$1"; }
insmod /modules/csi5300.ko caller=caller
dmesg | grep "csi5300: probe at"
dmesg | grep -q "csi5300: probe at iwl_notification_wait"
dmesg | grep -q "csi5300: probe at iwl_trans_pcie_tx"
: >/tmp/recorder
csi5300 record /tmp/a.dat --records 500 2>/tmp/recorder &
recorder=$!
until grep -q "recording to" /tmp/recorder; do :; done
insmod /modules/caller.ko count=500
wait "$recorder"
[ "$(counter records) $(counter delivered) $(counter missed)" = "500 500 0" ]
csi5300 info /tmp/a.dat
rmmod caller csi5300

# Packets of another module than iwldvm are not the card's.
insmod /modules/csi5300.ko
insmod /modules/caller.ko
[ "$(counter phy) $(counter bfee)" = "0 0" ]
rmmod caller csi5300
