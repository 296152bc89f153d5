// SPDX-License-Identifier: GPL-2.0
/*
 * Calls iwl_notification_wait as iwldvm does for each packet, where there is no fake card (kernels whose transport
 * is no longer a table of functions): `count` frames, each 0xC0, 0xC1, 0xBB of 3 chains.
 */
#include <linux/module.h>
#include <linux/slab.h>
#include <linux/version.h>

/* iwlwifi/fw/notif-wait.h; the private structure is smaller than this. */
void iwl_notification_wait_init(void *wait_data);
bool iwl_notification_wait(void *wait_data, void *packet);

static unsigned int count = 100;
module_param(count, uint, 0444);

static u8 wait_data[512] __aligned(8);

static void call(u8 *packet, u8 command, u32 len)
{
	*(__le32 *)packet = cpu_to_le32(len + 4);
	packet[4] = command;
	packet[7] = 0x80;
	iwl_notification_wait(wait_data, packet);
}

static int __init caller_init(void)
{
	u8 *packet = (u8 *)get_zeroed_page(GFP_KERNEL), *data = packet + 8;
	unsigned int k;

	if (!packet)
		return -ENOMEM;
	iwl_notification_wait_init(wait_data);
	for (k = 0; k < count; k++) {
		memset(data, 0, 256);
		data[1] = 1;
		*(__le32 *)(data + 4) = cpu_to_le32(k * 1000);
		*(__le32 *)(data + 28) = cpu_to_le32(33 | 32 << 16);
		*(__le32 *)(data + 32) = cpu_to_le32(31);
		*(__le32 *)(data + 52) = cpu_to_le32(0x4101);
		data[60] = 0x24;
		call(packet, 0xc0, 64);
		memset(data, 0, 256);
		data[0] = 57;
		data[4] = 0x08;
		data[31] = k;
		data[61] = 3;
		call(packet, 0xc1, 65);
		memset(data, 0, 256);
		data[8] = 3;
		data[9] = 1;
		data[16] = 192;
		call(packet, 0xbb, 212);
	}
	free_page((unsigned long)packet);
	return 0;
}

static void __exit caller_exit(void)
{
}

module_init(caller_init);
module_exit(caller_exit);
MODULE_LICENSE("GPL");
MODULE_DESCRIPTION("Calls iwl_notification_wait, for tests");
#if LINUX_VERSION_CODE >= KERNEL_VERSION(6, 13, 0)
MODULE_IMPORT_NS("IWLWIFI");
#elif LINUX_VERSION_CODE >= KERNEL_VERSION(5, 18, 0)
MODULE_IMPORT_NS(IWLWIFI);
#endif
