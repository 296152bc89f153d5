// SPDX-License-Identifier: GPL-2.0
/*
 * The patched drivers' path to user space, for comparing times: sends 0xBB over the connector where the packet is
 * received (csitool's connector_send_msg: an allocation and cn_netlink_send, both atomic), with its bytes unchanged.
 */
#include <linux/connector.h>
#include <linux/module.h>
#include <linux/slab.h>
#include "fakecard.h"

#define CN_IDX_IWLAGN (CN_NETLINK_USERS + 0xf)
#define CN_VAL_IWLAGN 0x1
#define BFEE_NOTIF 0xbb

static bool patched;
module_param(patched, bool, 0644);
MODULE_PARM_DESC(patched, "send 0xBB over the connector as the patched drivers do");

void as_patched(const u8 *packet, size_t len)
{
	struct cn_msg *msg;

	if (!READ_ONCE(patched) || len < 8 || len > 1024 || packet[4] != BFEE_NOTIF)
		return;
	msg = kmalloc(sizeof(*msg) + 1 + len - 8, GFP_ATOMIC);
	if (!msg)
		return;
	memset(msg, 0, sizeof(*msg));
	msg->id.idx = CN_IDX_IWLAGN;
	msg->id.val = CN_VAL_IWLAGN;
	msg->len = 1 + len - 8;
	msg->data[0] = BFEE_NOTIF;
	memcpy(msg->data + 1, packet + 8, len - 8);
	cn_netlink_send(msg, 0, CN_IDX_IWLAGN, GFP_ATOMIC);
	kfree(msg);
}
