/* SPDX-License-Identifier: GPL-2.0 */
/*
 * Finds the card of a driver's pointer. cfg80211 allocates its wiphy, mac80211's structure and the driver's
 * own in one block, in this order: a pointer into the driver's belongs to the nearest wiphy below it in the same block.
 * The wiphy, which is not the driver's structure, has the card's MAC and its bus device.
 *
 * Included by csi5300.c only.
 */
#ifndef CSI5300_CARDS_H
#define CSI5300_CARDS_H

#include <linux/mm.h>
#include <linux/netdevice.h>
#include <linux/pci.h>
#include <net/cfg80211.h>
#include <net/net_namespace.h>

static unsigned int devices[8] = { 0x4235, 0x4236 };
static unsigned int devices_named = 2;
module_param_array_named(device, devices, uint, &devices_named, 0444);
MODULE_PARM_DESC(device, "PCI device numbers of the cards that get requests (the 5300's); 0: any card of the driver");

/* The caller is in an RCU read-side section. NULL for a card without an interface, and for other pointers. */
static struct wiphy *wiphy_of(const void *inside)
{
	struct wiphy *nearest = NULL;
	struct net_device *dev;
	struct net *net;

	if (!virt_addr_valid(inside))
		return NULL;
	for_each_net_rcu(net) {
		for_each_netdev_rcu(net, dev) {
			struct wiphy *wiphy = dev->ieee80211_ptr ? dev->ieee80211_ptr->wiphy : NULL;

			if (wiphy && (const void *)wiphy < inside && wiphy > nearest && virt_addr_valid(wiphy) &&
			    virt_to_head_page(wiphy) == virt_to_head_page(inside))
				nearest = wiphy;
		}
	}
	return nearest;
}

/* Whether a name is the card's: its MAC, its bus address, or one of its interfaces. Also in an RCU section. */
static bool is_called(struct wiphy *wiphy, const char *name)
{
	struct device *bus = wiphy_dev(wiphy);
	struct net_device *dev;
	char mac[18];

	scnprintf(mac, sizeof(mac), "%pM", wiphy->perm_addr);
	if (!strcasecmp(name, mac) || (bus && !strcmp(name, dev_name(bus))))
		return true;
	dev = dev_get_by_name_rcu(&init_net, name);
	return dev && dev->ieee80211_ptr && dev->ieee80211_ptr->wiphy == wiphy;
}

/* Whether the card of this pointer may get requests. */
static bool may_be_asked(const void *inside)
{
	struct wiphy *wiphy;
	struct device *bus;
	unsigned int k, number = 0;
	bool may = false;

	rcu_read_lock();
	wiphy = wiphy_of(inside);
	bus = wiphy ? wiphy_dev(wiphy) : NULL;
	if (bus && dev_is_pci(bus))
		number = to_pci_dev(bus)->device;
	rcu_read_unlock();
	for (k = 0; k < devices_named; k++)
		may |= !devices[k] || devices[k] == number;
	return may;
}

#endif
