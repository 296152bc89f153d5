# The module and the eBPF program on a kernel without a fake card: the functions that they probe exist, and calls like iwldvm's give
# records, the same from both.
for module in rfkill libarc4 cfg80211 mac80211 iwlwifi iwldvm; do load "$module"; done
counter() { cat "/sys/module/csi5300/counters/$1"; }
insmod /modules/csi5300.ko caller=caller
dmesg | grep "csi5300: probe at"
dmesg | grep -q "csi5300: probe at iwl_notification_wait"
dmesg | grep -q "csi5300: probe at iwl_trans_pcie_tx"
dmesg | grep -q "csi5300: probe at iwl_dvm_send_cmd_pdu"
# Before 5.11 and with PREEMPT_RT there is no return probe (csi5300_asks.h).
case $(uname -r) in
    4.* | 5.[0-9].* | 5.10.* | *-rt-*) [ "$(dmesg | grep -c "csi5300: probe at iwl_restore_stations")" = 0 ] ;;
    *) dmesg | grep -q "csi5300: probe at iwl_restore_stations" ;;
esac
: >/tmp/recorder
csi5300 record /tmp/a.dat --stop-after 500records 2>/tmp/recorder &
recorder=$!
until grep -q "recording to" /tmp/recorder; do :; done
: >/tmp/program
csi5300 record --stock /tmp/b.dat --stock=csitool --stop-after 500records 2>/tmp/program &
program=$!
until grep -q "recording to" /tmp/program; do kill -0 "$program" || { cat /tmp/program; exit 1; }; done
insmod /modules/caller.ko count=500
wait "$recorder"
wait "$program"
cmp /tmp/a.dat /tmp/b.dat
[ "$(counter records) $(counter delivered) $(counter missed)" = "500 500 0" ]
# Status 1: the caller's records have no CSI, which is reported.
status=0
csi5300 info /tmp/a.dat || status=$?
[ "$status" = 1 ]
rmmod caller csi5300

# Only iwldvm's packets count as the card's.
insmod /modules/csi5300.ko
insmod /modules/caller.ko
[ "$(counter phy) $(counter bfee)" = "0 0" ]
rmmod caller csi5300
